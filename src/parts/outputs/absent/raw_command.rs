//! No output is a motor.

use crate::monitor::Line;
use crate::parts::outputs::Outputs;
use crate::tables::parameters::Parameters;
use crate::tables::wire::Transfer;

impl Outputs {
    /// False.
    pub fn has_motors(&self) -> bool {
        false
    }

    /// False.
    pub fn are_commands_refused(&self) -> bool {
        false
    }

    /// [`Line::NONE`].
    pub fn act_on_raw_command(&mut self, _: &Transfer, _: &Parameters) -> Line {
        Line::NONE
    }
}
