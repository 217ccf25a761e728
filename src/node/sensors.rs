//! What the node measures: the readings of the ADC, the pulses of the shaft and the presses of the
//! button, on their way to the parts that compute from them.

use super::chores::Chores;
use super::health::Health;
use super::publisher::Publisher;
use super::temperature::Temperature;
use crate::hardware::{Input, ShaftPulses};
use crate::monitor::{Line, Monitor};
use crate::parts::battery::Battery;
use crate::parts::button::Button;
use crate::parts::power::Power;
use crate::parts::rpm::Shaft;
use crate::tables::condition::Conditions;
use crate::tables::parameters::{Parameter, Parameters};
use crate::tables::publication::Publication;

/// The sensors.
pub struct Sensors {
    /// The temperature.
    pub temperature: Temperature,
    /// Voltage and current of the circuit.
    pub power: Power,
    /// The charge of the battery.
    pub battery: Battery,
    /// The revolutions of the shaft.
    pub shaft: Shaft,
    /// The presses of the button.
    pub button: Button,
}

impl Sensors {
    /// Nothing is measured yet.
    pub const fn new() -> Self {
        Self {
            temperature: Temperature::new(),
            power: Power::new(),
            battery: Battery::new(),
            shaft: Shaft::new(),
            button: Button::new(),
        }
    }

    /// Takes a reading of the ADC, which measures the input `next` now.
    pub fn read_input(&mut self, reading: u16, next: Input, chores: &mut Chores) {
        let (input, is_complete) = self.power.add(reading, next);
        if is_complete {
            chores.add(Chores::MEASURE_POWER);
        }
        if input == Input::Sensor && self.temperature.add(reading) {
            chores.add(Chores::MEASURE);
        }
    }

    /// Computes voltage and current of the circuit, and the charge that the battery gave.
    #[inline(never)]
    pub fn measure_power(&mut self, parameters: &Parameters, now_ms: u16) {
        // Before the first measurement no current is known.
        let was_measured = self.power.is_known();
        self.power.measure(parameters);
        let centiamperes = if was_measured { self.power.centiamperes() } else { 0 };
        self.battery.add(centiamperes, now_ms);
    }

    /// Takes the state of the button during the last `passed_ms` milliseconds.
    pub fn read_button(
        &mut self,
        is_pressed: bool,
        passed_ms: u8,
        publisher: &mut Publisher,
        monitor: &mut Monitor,
    ) {
        if self.button.tick(is_pressed, passed_ms) {
            monitor.log_line(Line::Button).set_a(self.button.count());
            publisher.publish(Publication::PRESSES);
        }
        if self.button.counts_tenth(passed_ms) {
            publisher.publish(Publication::Button);
        }
    }

    /// True if the board should count the pulses of the shaft.
    pub fn counts_pulses(parameters: &Parameters) -> bool {
        parameters.is_on(Parameter::RpmRate)
    }

    /// Takes the pulses of the shaft since the last call. Call it each millisecond.
    pub fn read_shaft(
        &mut self,
        pulses: ShaftPulses,
        now_ms: u16,
        parameters: &Parameters,
        monitor: &mut Monitor,
    ) {
        self.shaft.tick(pulses, now_ms, parameters, monitor);
    }

    /// Logs the measurements, and sets or clears their conditions. Call once a second.
    pub fn second(&mut self, parameters: &Parameters, health: &mut Health, monitor: &mut Monitor) {
        self.temperature.second(health, monitor);
        let is_wrong = self.power.second(parameters, monitor);
        health.set(Conditions::POWER, is_wrong);
    }
}
