//! No circuit is measured.

use crate::hardware::Input;
use crate::monitor::Monitor;
use crate::tables::parameters::Parameters;

/// actuator.Status.power_rating_pct: unknown.
const RATING_UNKNOWN: u8 = 127;

/// Nothing.
#[derive(Default)]
pub struct Power;

impl Power {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// The temperature sensor.
    pub fn next_input(&self, _parameters: &Parameters) -> Input {
        Input::Sensor
    }

    /// A reading of the temperature sensor.
    pub fn add(&mut self, _reading: u16, _next: Input) -> (Input, bool) {
        (Input::Sensor, false)
    }

    /// False.
    pub fn is_known(&self) -> bool {
        false
    }

    /// 0.
    pub fn voltage(&self) -> u16 {
        0
    }

    /// 0.
    pub fn current(&self) -> u16 {
        0
    }

    /// 0.
    pub fn centiamperes(&self) -> i16 {
        0
    }

    /// 0.
    pub fn flags(&self) -> u8 {
        0
    }

    /// Unknown.
    pub fn rating_percent(&self, _output: usize, _parameters: &Parameters) -> u8 {
        RATING_UNKNOWN
    }

    /// Does nothing.
    pub fn measure(&mut self, _parameters: &Parameters) {}

    /// Does nothing.
    pub fn second(&mut self, _: &Parameters, _: &mut Monitor) -> bool {
        false
    }
}
