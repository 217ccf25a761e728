//! Without ArmingStatus: nobody is disarmed.

use crate::tables::parameters::Parameters;

/// False.
pub const IS_BY_SOURCE: bool = false;

/// Nothing.
#[derive(Default)]
pub struct Arming;

impl Arming {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// Does nothing.
    pub fn act_on_status(&mut self, _id: u8, _status: u8) {}

    /// False.
    pub fn is_armed(&self) -> bool {
        false
    }

    /// False.
    pub fn is_disarmed(&self, _parameters: &Parameters) -> bool {
        false
    }

    /// False.
    pub fn is_only_armed_by_others(&self, _id: u8) -> bool {
        false
    }

    /// False.
    pub fn is_armed_by(&self, _id: u8) -> bool {
        false
    }

    /// False.
    pub fn is_disarmed_by(&self, _id: u8, _parameters: &Parameters) -> bool {
        false
    }

    /// False.
    pub fn is_said_disarmed(&self) -> bool {
        false
    }

    /// Does nothing.
    pub fn second(&mut self) {}
}
