//! The levels of pins without pulses, for a kind of output that drives them.

use super::super::pulses::Pulses;

/// Sets the level of one pin at each call. In each set, bit n is output n.
pub struct Levels {
    /// Outputs whose pins have a level of the kind.
    driven: u8,
    /// The output whose level was set last, and its bit.
    shown: u8,
    shown_bit: u8,
}

impl Levels {
    /// No pin has a level.
    pub const fn new() -> Self {
        Self { driven: 0, shown: 0, shown_bit: 0 }
    }

    /// Sets the level of the next output's pin: high if it is in `high`. Call from `Kind::show`
    /// with the outputs of the kind: each has its turn once in eight calls.
    #[inline(always)]
    pub fn drive(&mut self, outputs: u8, high: u8, board: &mut impl Pulses) {
        self.shown += 1;
        self.shown_bit <<= 1;
        if self.shown_bit == 0 {
            (self.shown, self.shown_bit) = (0, 1);
        }
        let bit = self.shown_bit;
        if (outputs | self.driven) & bit == 0 {
            return;
        }
        // The pin of an output that is not of the kind any more becomes low once.
        self.driven = self.driven & !bit | outputs & bit;
        board.set_level(self.shown.into(), high & outputs & bit != 0);
    }
}
