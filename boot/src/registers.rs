//! The registers of the chip that the loader uses, by their names and bits in the datasheet (Atmel
//! 2545, section 31). The ATmega328P has them at the same addresses.

/// A register of eight bits, by its address in the data memory.
#[derive(Clone, Copy)]
pub struct Register(u16);

impl Register {
    /// Reads the register.
    #[inline(always)]
    pub fn read(self) -> u8 {
        // SAFETY: only the constants below exist. Each is a register of the chip, which any value
        // may be read from.
        unsafe { core::ptr::with_exposed_provenance::<u8>(self.0.into()).read_volatile() }
    }

    /// Writes the register.
    #[inline(always)]
    pub fn write(self, value: u8) {
        // SAFETY: only the constants below exist. Each is a register of the chip, and no variable
        // is there.
        unsafe { core::ptr::with_exposed_provenance_mut::<u8>(self.0.into()).write_volatile(value) }
    }

    /// Sets the bits in `mask`.
    #[inline(always)]
    pub fn set(self, mask: u8) {
        self.write(self.read() | mask);
    }

    /// Clears the bits in `mask`.
    #[inline(always)]
    pub fn clear(self, mask: u8) {
        self.write(self.read() & !mask);
    }

    /// True if any bit in `mask` is 1.
    #[inline(always)]
    pub fn has(self, mask: u8) -> bool {
        self.read() & mask != 0
    }
}

/// DDRx and PORTx of the port `B`, `C` or `D`.
pub const fn port(name: u8) -> (Register, Register) {
    match name {
        b'B' => (Register(0x24), Register(0x25)),
        b'C' => (Register(0x27), Register(0x28)),
        _ => (Register(0x2A), Register(0x2B)),
    }
}

/// Registers without a function in the loader, which hold its variables: Timer0 stands still.
/// Instructions for them are half as long as for RAM.
pub mod idle {
    use super::Register;

    pub const GPIOR0: Register = Register(0x3E);
    pub const OCR0A: Register = Register(0x47);
    /// Whoever reads the EEPROM changes it.
    pub use super::EEDR;

    pub const GPIOR1: Register = Register(0x4A);
    pub const GPIOR2: Register = Register(0x4B);
}

pub const TIFR1: Register = Register(0x36);
pub const OCF1A: u8 = 1 << 1;
pub const TCCR1B: Register = Register(0x81);
pub const WGM12: u8 = 1 << 3;
/// The clock of Timer1 is that of the chip, divided by 1024.
pub const CS12_CS10: u8 = 1 << 2 | 1 << 0;
pub const OCR1AL: Register = Register(0x88);
pub const OCR1AH: Register = Register(0x89);

pub const EEDR: Register = Register(0x40);

pub const SPCR: Register = Register(0x4C);
pub const SPE: u8 = 1 << 6;
pub const MSTR: u8 = 1 << 4;
pub const SPSR: Register = Register(0x4D);
pub const SPIF: u8 = 1 << 7;
pub const SPI2X: u8 = 1 << 0;
pub const SPDR: Register = Register(0x4E);

pub const UCSR0A: Register = Register(0xC0);
pub const RXC0: u8 = 1 << 7;
pub const UDRE0: u8 = 1 << 5;
pub const U2X0: u8 = 1 << 1;
pub const UCSR0B: Register = Register(0xC1);
pub const RXEN0: u8 = 1 << 4;
pub const TXEN0: u8 = 1 << 3;
pub const UBRR0L: Register = Register(0xC4);
pub const UDR0: Register = Register(0xC6);

pub const MCUSR: Register = Register(0x54);
pub const WDRF: u8 = 1 << 3;
pub const EXTRF: u8 = 1 << 1;
/// SPMCSR.
pub const RWWSRE: u8 = 1 << 4;
pub const PGWRT: u8 = 1 << 2;
pub const PGERS: u8 = 1 << 1;
pub const SELFPRGEN: u8 = 1 << 0;
/// WDTCSR.
pub const WDIF: u8 = 1 << 7;
pub const WDIE: u8 = 1 << 6;
pub const WDCE: u8 = 1 << 4;
pub const WDE: u8 = 1 << 3;
/// A timeout of a second.
pub const WDP2_WDP1: u8 = 1 << 2 | 1 << 1;
