//! Acceptance filters and masks (DS20001801J 4.5).

use crate::registers::IDE;

/// The registers of a filter or a mask: SIDH, SIDL, EID8 and EID0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pattern([u8; 4]);

impl Pattern {
    /// A filter for an extended identifier, most significant byte first.
    pub const fn filter(id: [u8; 4]) -> Self {
        Self(registers(id))
    }

    /// A mask: a bit of 1 compares that bit of the identifier.
    pub const fn mask(id: [u8; 4]) -> Self {
        let [sidh, sidl, eid8, eid0] = registers(id);
        // A mask has no bit for the kind of frame.
        Self([sidh, sidl & !IDE, eid8, eid0])
    }

    /// SIDH, SIDL, EID8 and EID0.
    pub const fn registers(self) -> [u8; 4] {
        self.0
    }
}

/// What the chip accepts: six filters and two masks. Filters 0 and 1 go with mask 0 and buffer 0, filters 2 to 5 with mask 1 and
/// buffer 1. What finds buffer 0 full goes to buffer 1.
///
/// A trait, so that the registers need not be in RAM. [`Filters`] implements it for those that are.
pub trait Acceptance {
    /// Register `n` of 32: four of each filter from 0 to 5, then four of each mask. See [`Pattern`].
    fn register(&self, n: u8) -> u8;
}

/// Six filters and two masks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Filters {
    /// Two of buffer 0, four of buffer 1.
    pub filters: [Pattern; 6],
    /// One of buffer 0, one of buffer 1.
    pub masks: [Pattern; 2],
}

impl Filters {
    /// Accepts every frame with an extended identifier, in buffer 0 first, so that all frames stay in order.
    pub const ALL_EXTENDED: Self =
        Self { filters: [Pattern::filter([0; 4]); 6], masks: [Pattern::mask([0; 4]), Pattern::mask([0; 4])] };
}

impl Acceptance for Filters {
    fn register(&self, n: u8) -> u8 {
        let at = usize::from(n / 4);
        let pattern = self.filters.get(at).or_else(|| self.masks.get(at.wrapping_sub(self.filters.len())));
        pattern.map_or(0, |pattern| pattern.0[usize::from(n % 4)])
    }
}

/// SIDH, SIDL, EID8 and EID0 for an extended identifier: bits 28..21; 20..18, IDE and 17..16; 15..8; 7..0.
const fn registers([b3, b2, b1, b0]: [u8; 4]) -> [u8; 4] {
    [sidh(b3, b2), sidl(b2), b1, b0]
}

/// SIDH from the first two bytes of an identifier.
pub const fn sidh(b3: u8, b2: u8) -> u8 {
    b3 << 3 | b2 >> 5
}

/// SIDL from the second byte of an identifier.
pub const fn sidl(b2: u8) -> u8 {
    (b2 << 3) & 0b1110_0000 | IDE | b2 & 0b11
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_are_laid_out_as_the_datasheet_draws_them() {
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
