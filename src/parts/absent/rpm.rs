//! No shaft.

use crate::hardware::ShaftPulses;
use crate::monitor::Monitor;
use crate::tables::parameters::Parameters;

absent! {
    Shaft;
    fn tick(&mut self, _: ShaftPulses, _now_ms: u16, _: &Parameters, _: &mut Monitor);
    fn put(&self, _pulses_in_turn: u8, _now_ms: u16, _put: impl FnMut(u16));
}
