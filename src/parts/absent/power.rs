//! No circuit is measured.

use crate::hardware::Input;
use crate::monitor::Monitor;
use crate::tables::parameters::Parameters;

/// actuator.Status.power_rating_pct: unknown.
const RATING_UNKNOWN: u8 = 127;

absent! {
    Power;
    // The temperature sensor.
    fn next_input(&self, _parameters: &Parameters) -> Input = Input::Sensor;
    // A reading of the temperature sensor.
    fn add(&mut self, _reading: u16, _next: Input) -> (Input, bool) = (Input::Sensor, false);
    fn is_known(&self) -> bool = false;
    fn voltage(&self) -> u16 = 0;
    fn current(&self) -> u16 = 0;
    fn centiamperes(&self) -> i16 = 0;
    fn flags(&self) -> u8 = 0;
    fn rating_percent(&self, _output: usize, _parameters: &Parameters) -> u8 = RATING_UNKNOWN;
    fn measure(&mut self, _parameters: &Parameters);
    fn second(&mut self, _: &Parameters, _: &mut Monitor) -> bool = false;
}
