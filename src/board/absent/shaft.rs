//! No pulses are counted.

use super::chip::TC2;
use firmware::hardware::ShaftPulses;

/// Nothing.
pub struct Shaft;

impl Shaft {
    pub(super) fn new(_tc2: TC2) -> Self {
        Self
    }

    /// None.
    pub fn pulses(&mut self, _is_on: bool) -> ShaftPulses {
        ShaftPulses::NONE
    }
}
