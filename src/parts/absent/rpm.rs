//! No shaft.

use crate::hardware::ShaftPulses;
use crate::monitor::Monitor;
use crate::tables::parameters::Parameters;

/// Nothing.
#[derive(Default)]
pub struct Shaft;

impl Shaft {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// Does nothing.
    pub fn tick(&mut self, _: ShaftPulses, _now_ms: u16, _: &Parameters, _: &mut Monitor) {}

    /// Does nothing.
    pub fn put(&self, _pulses_in_turn: u8, _now_ms: u16, _put: impl FnMut(u16)) {}
}
