//! No light.

use dronecan_wire::Slot;

use crate::tables::parameters::Parameters;

/// Nothing.
#[derive(Default)]
pub struct Lights;

impl Lights {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// Does nothing.
    pub fn update(&mut self, _parameters: &Parameters) {}

    /// `None`.
    pub fn slot_of(&self, _id: u8) -> Option<Slot> {
        None
    }

    /// 0.
    pub fn brightness(&self) -> u8 {
        0
    }

    /// Does nothing.
    pub fn act_on_command(&mut self, _entry: &[u8]) {}
}
