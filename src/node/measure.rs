//! The readings of the ADC and the pulses of the shaft, on their way to the parts that compute from
//! them.

use super::Node;
use super::chores::Chore;
use crate::hardware::{Input, ShaftPulses};
use crate::monitor::Monitor;
use crate::tables::parameters::Parameter;

impl Node {
    /// The input of the ADC for the next reading.
    pub fn next_input(&self) -> Input {
        self.power.next_input(&self.parameters)
    }

    /// Takes a reading of the ADC, which measures the input `next` now.
    pub fn read_input(&mut self, reading: u16, next: Input) {
        let (input, is_complete) = self.power.add(reading, next);
        if is_complete {
            self.chores.add(Chore::MeasurePower);
        }
        if input == Input::Sensor && self.temperature.add(reading) {
            self.chores.add(Chore::Measure);
        }
    }

    /// Computes voltage and current of the circuit, and the charge that the battery gave.
    #[inline(never)]
    pub(super) fn measure_power(&mut self, now_ms: u16) {
        // Before the first measurement no current is known.
        let was_measured = self.power.is_known();
        self.power.measure(&self.parameters);
        let centiamperes = if was_measured { self.power.centiamperes() } else { 0 };
        self.battery.add(centiamperes, now_ms);
    }

    /// True if the board should count the pulses of the shaft.
    pub fn counts_pulses(&self) -> bool {
        self.parameters.is_on(Parameter::RpmRate)
    }

    /// Takes the pulses of the shaft since the last call. Call it each millisecond.
    pub fn read_shaft(&mut self, pulses: ShaftPulses, now_ms: u16, monitor: &mut Monitor) {
        self.shaft.tick(pulses, now_ms, &self.parameters, monitor);
    }
}
