//! What the board does with the pulses.

use super::travel::Ticks;

/// The outputs of the board, which make the pulses.
pub trait Pulses {
    /// Sets the width of an output's pulse from the next period on; 0 ends the pulses. Does not cut
    /// a pulse that has begun, so the pulses end at the first call between two pulses.
    fn set(&mut self, output: usize, width: Ticks);

    /// The output whose pulse begins next, if the pulses begin one after the other.
    #[inline(always)]
    fn next(&self) -> Option<u8> {
        None
    }

    /// Sets the level of the pin of an output without pulses.
    #[inline(always)]
    fn set_level(&mut self, _output: usize, _is_high: bool) {}
}
