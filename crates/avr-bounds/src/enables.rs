//! The bits that enable interrupts.

use crate::chip::INTERRUPTS;

/// The registers with bits that enable interrupts, in the data space.
pub const ENABLE_REGISTERS: [u16; 13] =
    [0x3D, 0x3F, 0x4C, 0x50, 0x57, 0x60, 0x68, 0x6E, 0x6F, 0x70, 0x7A, 0xBC, 0xC1];

/// The bits of these registers that enable interrupts. The chip changes others by itself, such as
/// EEPE and SELFPRGEN, so nothing is known of them.
pub const ENABLE_BITS: [u8; ENABLE_REGISTERS.len()] = {
    let (mut bits, mut at) = ([0; ENABLE_REGISTERS.len()], 0);
    while at < ENABLE_REGISTERS.len() {
        let mut index = 0;
        while index < INTERRUPTS.len() {
            let (register, bit) = INTERRUPTS[index].enable;
            if register == ENABLE_REGISTERS[at] {
                bits[at] |= 1 << bit;
            }
            index += 1;
        }
        at += 1;
    }
    bits
};

/// The register with the enable bit of each of [`INTERRUPTS`]: an index of [`ENABLE_REGISTERS`].
const ENABLE_OF: [usize; INTERRUPTS.len()] = {
    let (mut of, mut interrupt) = ([0; INTERRUPTS.len()], 0);
    while interrupt < INTERRUPTS.len() {
        while ENABLE_REGISTERS[of[interrupt]] != INTERRUPTS[interrupt].enable.0 {
            of[interrupt] += 1;
        }
        interrupt += 1;
    }
    of
};

/// The interrupt of the watchdog clears its own enable bit (datasheet 2545, WDIE in WDTCSR).
const WDTCSR: u16 = 0x60;

/// What is known of the bits that enable interrupts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Enables {
    /// Bits that are 0, for each of [`ENABLE_REGISTERS`].
    pub zeros: [u8; ENABLE_REGISTERS.len()],
    /// Bits that are 1.
    pub ones: [u8; ENABLE_REGISTERS.len()],
}

impl Enables {
    /// Index of a register.
    pub fn index(register: u16) -> Option<usize> {
        ENABLE_REGISTERS.iter().position(|known| *known == register)
    }

    /// A bit, if it is known.
    pub fn get(&self, register: u16, bit: u8) -> Option<bool> {
        let at = Self::index(register)?;
        let mask = 1 << bit;
        match (self.zeros[at] & mask != 0, self.ones[at] & mask != 0) {
            (true, _) => Some(false),
            (_, true) => Some(true),
            _ => None,
        }
    }

    /// Sets a bit.
    pub fn set(&mut self, register: u16, bit: u8, value: bool) {
        if let Some((zeros, ones)) = self.read(register) {
            let mask = 1 << bit;
            let (zeros, ones) = match value {
                false => (zeros | mask, ones & !mask),
                true => (zeros & !mask, ones | mask),
            };
            self.write(register, zeros, ones);
        }
    }

    /// What is known of a register: the bits that are 0, and those that are 1.
    pub fn read(&self, register: u16) -> Option<(u8, u8)> {
        let at = Self::index(register)?;
        Some((self.zeros[at], self.ones[at]))
    }

    /// A write of a byte of which bits are known.
    pub fn write(&mut self, register: u16, zeros: u8, ones: u8) {
        if let Some(at) = Self::index(register) {
            let mask = ENABLE_BITS[at];
            let stays_one = if register == WDTCSR { 0 } else { mask };
            (self.zeros[at], self.ones[at]) = (zeros & mask, ones & stays_one);
        }
    }

    /// What is known of both.
    pub fn join(&mut self, other: &Self) {
        for at in 0..ENABLE_REGISTERS.len() {
            self.zeros[at] &= other.zeros[at];
            self.ones[at] &= other.ones[at];
        }
    }

    /// True if the enable bit of an interrupt, an index of [`INTERRUPTS`], is known to be 0.
    pub fn is_masked(&self, interrupt: usize) -> bool {
        self.zeros[ENABLE_OF[interrupt]] & 1 << INTERRUPTS[interrupt].enable.1 != 0
    }

    /// True if it is known to be 1.
    pub fn is_unmasked(&self, interrupt: usize) -> bool {
        self.ones[ENABLE_OF[interrupt]] & 1 << INTERRUPTS[interrupt].enable.1 != 0
    }
}
