//! Computes the temperature from a sensor whose voltage rises with it, read by a 10-bit ADC.
//!
//! The default is an LM35 (10 mV per degree Celsius, 0 V at zero) against 5 V, where a step of the
//! ADC is 0.49 degrees. The feature `sensors` has parameters for others. The node adds up 64
//! readings, one each millisecond. The noise of the ADC is half a step or more and spreads the
//! readings over several steps, so the sum has a finer resolution than one reading.

use crate::math::scaled;
use crate::tables::parameters::{Parameter, Parameters, TEMP_SLOPE};

/// There is a sensor if so many readings in a row are between the ends of the range.
const FOUND: u8 = 16;

/// Readings in a sum. The largest possible sum, 64 x 1023, fits in 16 bits.
const READINGS: u8 = 64;

/// 0 degrees Celsius in 64ths of a kelvin, rounded.
pub const ZERO_CELSIUS: u16 = 17_482;
/// The lower limit of the whole degree 0: half a degree below zero.
pub const DEGREE_ZERO: u16 = ZERO_CELSIUS - 32;

/// The reference voltage of the ADC in units of 0.8 mV, for TEMP_REF 0 and 1 (ATmega168: AVCC of 5
/// V, and the bandgap of nominal 1.1 V). 64ths of a kelvin are half a sum x this / (64 x
/// TEMP_SLOPE).
const AVCC: u16 = 6250;
const BANDGAP: u16 = 1375;

/// True if the build has no parameter of the sensor. Then the largest sum is 772.7 K, which is
/// below all limits.
const IS_FIXED: bool = !Parameter::TempSlope.is_built();
const _: () = assert!(u16::MAX as u32 / 2 * AVCC as u32 / (TEMP_SLOPE as u32 * 64) < 32_735);

/// Adds up readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Thermometer {
    sum: u16,
    count: u8,
    latest: u16,
    has_measured: bool,
    /// Readings in a row between the ends of the range; stays at [`FOUND`].
    in_range: u8,
}

impl Thermometer {
    /// A thermometer without readings.
    pub const fn new() -> Self {
        Self { sum: 0, count: 0, latest: 0, has_measured: false, in_range: 0 }
    }

    /// Takes a reading of the ADC, 0 to 1023. Returns true if it completes a sum.
    pub fn add(&mut self, reading: u16) -> bool {
        if self.in_range != FOUND {
            self.in_range = if matches!(reading, 1..=1022) { self.in_range + 1 } else { 0 };
        }
        self.sum = self.sum.wrapping_add(reading);
        self.count = self.count.wrapping_add(1);
        if self.count != READINGS {
            return false;
        }
        self.latest = self.sum;
        self.has_measured = true;
        self.sum = 0;
        self.count = 0;
        true
    }

    /// True if a sum is complete. False in the first 64 ms.
    pub fn has_measured(&self) -> bool {
        self.has_measured
    }

    /// True if [`FOUND`] readings in a row were between the ends of the range since the start.
    pub fn is_found(&self) -> bool {
        self.in_range == FOUND
    }

    /// True if the readings are at either end of the range, which no working sensor gives: the
    /// sensor or its cable is open or shorted.
    pub fn is_sensor_faulty(&self) -> bool {
        self.latest.wrapping_sub(u16::from(READINGS)) > (1022 - 1) * u16::from(READINGS)
    }

    /// The temperature for a sensor with 0 V at 0 degrees, in 64ths of a kelvin, rounded.
    pub fn uncorrected(&self, parameters: &Parameters) -> u16 {
        let reference = if parameters.is_on(Parameter::TempRef) { BANDGAP } else { AVCC };
        let slope = parameters.get_or(Parameter::TempSlope, TEMP_SLOPE);
        let above_zero = scaled(self.latest >> 1, reference, slope << 6);
        if IS_FIXED {
            return above_zero.wrapping_add(ZERO_CELSIUS);
        }
        above_zero.saturating_add(ZERO_CELSIUS)
    }
}

/// Corrects a temperature from [`uncorrected`](Thermometer::uncorrected) by TEMP_OFFSET. The result
/// is in 64ths of a kelvin, rounded, and at most 784.6 K.
pub fn corrected(measured: u16, parameters: &Parameters) -> u16 {
    // TEMP_OFFSET is in mV and TEMP_SLOPE in 0.1 mV per kelvin: times 10 for the unit and times 64
    // for 64ths of a kelvin is 640.
    let offset = parameters.get(Parameter::TempOffset) as i16;
    if IS_FIXED {
        return measured;
    }
    if offset == 0 {
        return measured.min(DEGREE_ZERO + 32_767);
    }
    let slope = parameters.get_or(Parameter::TempSlope, TEMP_SLOPE);
    let at_zero = scaled(offset.unsigned_abs(), 640, slope);
    let kelvin_64ths = if offset < 0 {
        measured.saturating_add(at_zero)
    } else {
        measured.saturating_sub(at_zero)
    };
    kelvin_64ths.min(DEGREE_ZERO + 32_767)
}

/// Whole degrees Celsius, rounded to the nearest; halves are rounded up.
pub fn celsius(kelvin_64ths: u16) -> i16 {
    (kelvin_64ths.wrapping_sub(DEGREE_ZERO) as i16) >> 6
}

#[cfg(test)]
mod tests;
