//! The temperature: the last measurement, and its limits.

use super::condition::Conditions;
use super::health::Health;
use super::parameters::{Parameter, Parameters};
use super::thermometer::{DEGREE_ZERO, Thermometer, celsius, corrected};
use crate::monitor::{Line, Monitor};

/// Error flag of a Temperature: above the limit (DSDL 1110.Temperature.uavcan).
const OVERHEATING: u8 = 1;
/// Error flag of a Temperature: below the limit.
const OVERCOOLING: u8 = 2;

/// The temperature.
pub struct Temperature {
    thermometer: Thermometer,
    kelvin_64ths: u16,
    celsius: i16,
    flags: u8,
}

impl Temperature {
    /// A temperature that is not measured yet.
    pub const fn new() -> Self {
        Self { thermometer: Thermometer::new(), kelvin_64ths: 0, celsius: 0, flags: 0 }
    }

    /// Takes a reading of the ADC. Returns true if it is time to [`measure`](Self::measure).
    pub fn add(&mut self, reading: u16) -> bool {
        self.thermometer.add(reading)
    }

    /// True if a sum of readings is complete. False in the first 64 ms.
    pub fn is_known(&self) -> bool {
        self.thermometer.has_measured()
    }

    /// The temperature in 64ths of a kelvin.
    pub fn kelvin_64ths(&self) -> u16 {
        self.kelvin_64ths
    }

    /// The temperature in whole degrees Celsius.
    pub fn celsius(&self) -> i16 {
        self.celsius
    }

    /// The error flags of a Temperature.
    pub fn flags(&self) -> u8 {
        self.flags
    }

    /// Computes the temperature from the last sum of readings, and compares it with TEMP_MIN and TEMP_MAX.
    #[inline(never)]
    pub fn measure(&mut self, parameters: &Parameters) {
        self.kelvin_64ths = corrected(self.thermometer.uncorrected(parameters), parameters);
        self.celsius = celsius(self.kelvin_64ths);
        self.flags = if self.celsius < parameters.get(Parameter::TempMin) as i16 {
            OVERCOOLING
        } else if self.celsius > parameters.get(Parameter::TempMax) as i16 {
            OVERHEATING
        } else {
            0
        };
    }

    /// Logs the temperature, and sets or clears the conditions for its limits and its sensor. Call once a second.
    #[inline(always)]
    pub fn second(&self, health: &mut Health, monitor: &mut Monitor) {
        if !self.is_known() {
            return;
        }
        // A whole degree begins five tenths below its value.
        let fraction = self.kelvin_64ths.wrapping_sub(DEGREE_ZERO) & 63;
        let tenths = (self.celsius as u16).wrapping_mul(10).wrapping_add((fraction * 10) >> 6).wrapping_sub(5);
        monitor.log_line(Line::Temperature).a = tenths;
        health.set(Conditions::TEMPERATURE, self.flags != 0, [Line::OutOfRange, Line::OutOfRangeEnd], monitor);
        let is_faulty = self.thermometer.is_sensor_faulty();
        health.set(Conditions::SENSOR, is_faulty, [Line::SensorFault, Line::SensorFaultEnd], monitor);
    }
}

impl Default for Temperature {
    fn default() -> Self {
        Self::new()
    }
}
