//! Acceptance filters and masks (DS20001801J 4.5).

use crate::bit_timing::BitTiming;
use crate::registers::IDE;

/// The registers of a filter or a mask: SIDH, SIDL, EID8 and EID0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pattern([u8; 4]);

impl Pattern {
    /// Makes a filter for an extended identifier, most significant byte first.
    pub const fn filter(id: [u8; 4]) -> Self {
        Self(registers(id))
    }

    /// Makes a mask. The chip compares the bits of the identifier that are 1 in the mask.
    pub const fn mask(id: [u8; 4]) -> Self {
        let [sidh, sidl, eid8, eid0] = registers(id);
        // A mask has no bit for standard or extended.
        Self([sidh, sidl & !IDE, eid8, eid0])
    }

    /// Makes a filter for a standard identifier of 11 bits. The chip accepts it in data and in
    /// remote frames.
    pub const fn standard_filter(id: u16) -> Self {
        Self([(id >> 3) as u8, (id << 5) as u8, 0, 0])
    }

    /// Makes a mask for standard identifiers. With an extended identifier the chip compares the
    /// upper 11 bits.
    pub const fn standard_mask(id: u16) -> Self {
        Self::standard_filter(id)
    }

    /// SIDH, SIDL, EID8 and EID0.
    pub const fn registers(self) -> [u8; 4] {
        self.0
    }
}

/// The acceptance of the chip: six filters and two masks. Filters 0 and 1 belong to mask 0 and
/// buffer 0, filters 2 to 5 to mask 1 and buffer 1. A frame that finds buffer 0 full goes to buffer
/// 1.
///
/// It is a trait so that the registers need not be in RAM. [`Filters`] implements it for registers
/// in RAM.
pub trait Acceptance {
    /// Returns register `n` of 32: four registers of each filter from 0 to 5, then four of each
    /// mask. See [`Pattern`].
    fn register(&self, n: u8) -> u8;

    /// Returns the timing with which the chip listens next. The driver asks when the chip listens
    /// because the bus has another bit rate, and has heard an error with the present timing. `None`
    /// keeps that one. A node that finds the bit rate of its bus returns one after the other.
    fn next_timing(&mut self) -> Option<BitTiming> {
        None
    }
}

/// Six filters and two masks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Filters {
    /// Two filters of buffer 0, four of buffer 1.
    pub filters: [Pattern; 6],
    /// One mask of buffer 0, one of buffer 1.
    pub masks: [Pattern; 2],
}

impl Filters {
    /// Accepts every frame, first in buffer 0, so that all frames stay in order.
    pub const ALL: Self = Self {
        filters: [
            Pattern::standard_filter(0),
            Pattern::filter([0; 4]),
            Pattern::standard_filter(0),
            Pattern::filter([0; 4]),
            Pattern::standard_filter(0),
            Pattern::filter([0; 4]),
        ],
        masks: [Pattern::mask([0; 4]), Pattern::mask([0; 4])],
    };

    /// Accepts every frame with a standard identifier, first in buffer 0, so that all frames stay
    /// in order.
    pub const ALL_STANDARD: Self =
        Self { filters: [Pattern::standard_filter(0); 6], masks: [Pattern::standard_mask(0); 2] };

    /// Accepts every frame with an extended identifier, first in buffer 0, so that all frames stay
    /// in order.
    pub const ALL_EXTENDED: Self = Self {
        filters: [Pattern::filter([0; 4]); 6],
        masks: [Pattern::mask([0; 4]), Pattern::mask([0; 4])],
    };
}

impl Acceptance for Filters {
    fn register(&self, n: u8) -> u8 {
        let at = usize::from(n / 4);
        let pattern =
            self.filters.get(at).or_else(|| self.masks.get(at.wrapping_sub(self.filters.len())));
        pattern.map_or(0, |pattern| pattern.0[usize::from(n % 4)])
    }
}

/// SIDH, SIDL, EID8 and EID0 for an extended identifier: bits 28..21; 20..18, IDE and 17..16;
/// 15..8; 7..0.
const fn registers([b3, b2, b1, b0]: [u8; 4]) -> [u8; 4] {
    [sidh(b3, b2), sidl(b2), b1, b0]
}

/// SIDH, from the first two bytes of an identifier.
pub const fn sidh(b3: u8, b2: u8) -> u8 {
    b3 << 3 | b2 >> 5
}

/// SIDL, from the second byte of an identifier.
pub const fn sidl(b2: u8) -> u8 {
    (b2 << 3) & 0b1110_0000 | IDE | b2 & 0b11
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_have_the_layout_of_the_datasheet() {
        // Registers 5-4 to 5-7: one bit at a time.
        for bit in 0..29 {
            let id = (1u32 << bit).to_be_bytes();
            let expected = match bit {
                0..8 => [0, 0x08, 0, 1 << bit],
                8..16 => [0, 0x08, 1 << (bit - 8), 0],
                16 | 17 => [0, 0x08 | 1 << (bit - 16), 0, 0],
                18..21 => [0, 0x08 | 1 << (bit - 18 + 5), 0, 0],
                _ => [1 << (bit - 21), 0x08, 0, 0],
            };
            assert_eq!(registers(id), expected, "bit {bit}");
        }
    }

    #[test]
    fn a_table_gives_its_filters_first_and_then_its_masks() {
        let filters = [1, 2, 3, 4, 5, 6].map(|n| Pattern::filter([0, 0, n, n + 10]));
        let masks = [7, 8].map(|n| Pattern::mask([0, 0, n, n + 10]));
        let table = Filters { filters, masks };
        for n in 0..8 {
            let ide = if n < 6 { 0x08 } else { 0 };
            assert_eq!([0, 1, 2, 3].map(|k| table.register(4 * n + k)), [0, ide, n + 1, n + 11]);
        }
        assert_eq!(table.register(32), 0);
    }
}
