//! The temperature: the last measurement, and its limits.

use super::health::Health;
use super::thermometer::{DEGREE_ZERO, Thermometer, celsius, corrected};
use crate::math::divided;
use crate::monitor::{Line, Monitor};
use crate::tables::condition::Conditions;
use crate::tables::parameters::{Parameter, Parameters};

/// Error flag of a Temperature: above the limit (DSDL 1110.Temperature.uavcan).
const OVERHEATING: u8 = 1;
/// Error flag of a Temperature: below the limit.
const OVERCOOLING: u8 = 2;
/// Not a flag of a Temperature: the sensor is open or shorted.
const SENSOR_FAULT: u8 = 1 << 7;

/// TEMP_SENSOR: when there is a sensor. 1 is when it was found.
mod sensor {
    /// Never.
    pub const NONE: u8 = 0;
    /// Always.
    pub const REQUIRED: u8 = 2;
}

/// The temperature.
pub struct Temperature {
    thermometer: Thermometer,
    kelvin_64ths: u16,
    celsius: i16,
    flags: u8,
    has_sensor: bool,
}

impl Temperature {
    /// A temperature that is not measured yet.
    pub const fn new() -> Self {
        Self {
            thermometer: Thermometer::new(),
            kelvin_64ths: 0,
            celsius: 0,
            flags: 0,
            has_sensor: false,
        }
    }

    /// Takes a reading of the ADC. Returns true if it is time to [`measure`](Self::measure).
    pub fn add(&mut self, reading: u16) -> bool {
        self.thermometer.add(reading)
    }

    /// True if a sum of readings is complete. False in the first 64 ms.
    pub fn is_known(&self) -> bool {
        self.thermometer.has_measured()
    }

    /// True if there is a sensor, by TEMP_SENSOR, and its temperature is known.
    pub fn has_sensor(&self) -> bool {
        self.has_sensor
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
        self.flags & !SENSOR_FAULT
    }

    /// Computes the temperature from the last sum of readings, and compares it with TEMP_MIN and
    /// TEMP_MAX.
    pub fn measure(&mut self, parameters: &Parameters) {
        self.has_sensor = match parameters.get(Parameter::TempSensor) as u8 {
            sensor::NONE => false,
            sensor::REQUIRED => true,
            _ => self.thermometer.is_found(),
        };
        self.kelvin_64ths = corrected(self.thermometer.uncorrected(parameters), parameters);
        self.celsius = celsius(self.kelvin_64ths);
        self.flags = if self.celsius < parameters.get(Parameter::TempMin) as i16 {
            OVERCOOLING
        } else if self.celsius > parameters.get(Parameter::TempMax) as i16 {
            OVERHEATING
        } else {
            0
        };
        if self.thermometer.is_sensor_faulty() {
            self.flags |= SENSOR_FAULT;
        }
    }

    /// Logs the temperature, and sets or clears the condition for its limits and its sensor. Call
    /// once a second.
    pub fn second(&self, health: &mut Health, monitor: &mut Monitor) {
        if self.has_sensor {
            // A whole degree begins five tenths below its value. From a whole multiple of a degree
            // on, so that no number is negative.
            const { assert!((DEGREE_ZERO + 22).is_multiple_of(64)) };
            let tenths = divided(5 * u32::from(self.kelvin_64ths + 22), 32) as u16;
            let zero = (DEGREE_ZERO + 22) / 64 * 10 + 5;
            monitor.log_line(Line::Temperature).set_a(tenths.wrapping_sub(zero));
        }
        health.set(Conditions::TEMPERATURE, self.has_sensor && self.flags != 0);
    }

    /// True if the sensor is open or shorted.
    pub fn is_sensor_faulty(&self) -> bool {
        self.flags & SENSOR_FAULT != 0
    }
}
