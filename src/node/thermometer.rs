//! Temperature from a sensor whose voltage rises with it, at a 10-bit ADC.
//!
//! By default an LM35 (10 mV per degree Celsius, 0 V at zero) against 5 V, where a step of the ADC is 0.49 degrees. Sixty-four
//! readings are added up, one each millisecond, so that the noise of the ADC, half a step or more, spreads them over its
//! steps and the sum resolves finer.

use super::parameters::{Parameter, Parameters};
use super::servo;

/// Readings in a sum. Their largest possible sum, 64 x 1023, just fits in 16 bits.
const READINGS: u8 = 64;

/// 0 degrees Celsius in 64ths of a kelvin, rounded.
pub const ZERO_CELSIUS: u16 = 17_482;
/// Where the whole degree 0 begins: half a degree below.
pub const DEGREE_ZERO: u16 = ZERO_CELSIUS - 32;

/// What the ADC measures against, in units of 0.8 mV, for TEMP_REF 0 and 1 (ATmega168: AVCC of 5 V, and the bandgap of
/// nominal 1.1 V): from half a sum to 64ths of a kelvin it is times this, by 64, by TEMP_SLOPE.
const AVCC: u16 = 6250;
const BANDGAP: u16 = 1375;

/// Adds up readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Thermometer {
    sum: u16,
    count: u8,
    latest: u16,
    has_measured: bool,
}

impl Thermometer {
    /// Before the first reading.
    pub const fn new() -> Self {
        Self { sum: 0, count: 0, latest: 0, has_measured: false }
    }

    /// Takes a reading of the ADC, 0 to 1023; whether that makes a new temperature.
    pub fn add(&mut self, reading: u16) -> bool {
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

    /// Whether there is a full sum: not in the first 64 ms.
    pub fn has_measured(&self) -> bool {
        self.has_measured
    }

    /// The sensor pulls to either end of the range, where none works: it is open or shorted, or so is its cable.
    pub fn is_sensor_faulty(&self) -> bool {
        self.latest.wrapping_sub(u16::from(READINGS)) > (1022 - 1) * u16::from(READINGS)
    }

    /// What a sensor of 0 V at 0 degrees would have measured, in 64ths of a kelvin, rounded.
    #[inline(always)]
    pub fn uncorrected(&self, parameters: &Parameters) -> u16 {
        let reference = if parameters.is_on(Parameter::TempRef) { BANDGAP } else { AVCC };
        let slope = parameters.get(Parameter::TempSlope);
        servo::scaled(self.latest >> 1, reference, slope << 6).saturating_add(ZERO_CELSIUS)
    }
}

/// What was [measured](Thermometer::uncorrected), corrected by TEMP_OFFSET: in 64ths of a kelvin, rounded, limited to 784.6 K.
#[inline(always)]
pub fn corrected(measured: u16, parameters: &Parameters) -> u16 {
    // A millivolt is ten tenths of a millivolt, and a kelvin 64 of its 64ths.
    let offset = parameters.get(Parameter::TempOffset) as i16;
    let at_zero = servo::scaled(offset.unsigned_abs(), 640, parameters.get(Parameter::TempSlope));
    let kelvin_64ths = if offset < 0 { measured.saturating_add(at_zero) } else { measured.saturating_sub(at_zero) };
    kelvin_64ths.min(DEGREE_ZERO + 32_767)
}

/// In whole degrees Celsius, rounded to the nearest, and a half up.
pub fn celsius(kelvin_64ths: u16) -> i16 {
    (kelvin_64ths.wrapping_sub(DEGREE_ZERO) as i16) >> 6
}

impl Default for Thermometer {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
