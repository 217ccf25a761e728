//! Without ArmingStatus: nobody is disarmed.

use crate::node::parameters::Parameters;

/// Nothing.
#[derive(Default)]
pub struct Arming;

impl Arming {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// Does nothing.
    pub fn act_on_status(&mut self, _status: u8) {}

    /// False.
    pub fn is_armed(&self) -> bool {
        false
    }

    /// False.
    pub fn is_disarmed(&self, _parameters: &Parameters) -> bool {
        false
    }

    /// Does nothing.
    pub fn second(&mut self) {}
}
