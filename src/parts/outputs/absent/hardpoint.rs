//! No output is a relay.

use crate::monitor::Line;
use crate::parts::outputs::Outputs;
use crate::tables::parameters::Parameters;

impl Outputs {
    /// [`Line::NONE`].
    pub fn act_on_hardpoint_command(&mut self, _: u8, _: u8, _: bool, _: &Parameters) -> Line {
        Line::NONE
    }

    /// `None`.
    pub fn next_relay(&mut self) -> Option<(u8, bool)> {
        None
    }
}
