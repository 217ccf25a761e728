//! Temperature from an LM35 (10 mV per degree Celsius, 0 V at zero) at a 10-bit ADC with a reference of 5 V.
//!
//! A step of the ADC is 0.49 degrees. Sixty-four readings are added up, one each millisecond, so that the noise of the
//! ADC, half a step or more, spreads them over its steps and the sum resolves finer.

/// Readings in a sum. Their largest possible sum, 64 x 1023, just fits in 16 bits.
const READINGS: u8 = 64;

/// A full sum of readings: 0 V is 0, 5 V is 65,536.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading(u16);

/// 10 mV a kelvin and 5 V over the range: 500 K. A sum times 64 of it is below 2^31, so that `wrapping_mul` below never wraps
/// (the checked one takes 500 bytes of library).
const RANGE_K: u32 = 500;

impl Reading {
    /// In 64ths of a kelvin, rounded.
    pub fn kelvin_64ths(self) -> u16 {
        // 273.15 K at 0 V. The largest sum stays below 2^32 by a quarter.
        const ZERO_CELSIUS: u32 = (27_315 * 64 * (1 << 16) / 100u64) as u32;
        ((u32::from(self.0).wrapping_mul(64 * RANGE_K) + ZERO_CELSIUS + (1 << 15)) >> 16) as u16
    }

    /// In whole degrees Celsius, rounded, and limited to 255.
    pub fn degrees(self) -> u8 {
        ((u32::from(self.0).wrapping_mul(RANGE_K) + (1 << 15)) >> 16).min(255) as u8
    }

    /// In tenths of a degree Celsius, rounded.
    pub fn tenths_celsius(self) -> u16 {
        ((u32::from(self.0).wrapping_mul(10 * RANGE_K) + (1 << 15)) >> 16) as u16
    }
}

/// Adds up readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Thermometer {
    sum: u16,
    count: u8,
    latest: Option<Reading>,
}

impl Thermometer {
    /// Before the first reading.
    pub const fn new() -> Self {
        Self { sum: 0, count: 0, latest: None }
    }

    /// Takes a reading of the ADC, 0 to 1023.
    pub fn add(&mut self, reading: u16) {
        self.sum = self.sum.saturating_add(reading);
        self.count += 1;
        if self.count == READINGS {
            self.latest = Some(Reading(self.sum));
            (self.sum, self.count) = (0, 0);
        }
    }

    /// The last full sum; `None` for the first 64 ms.
    pub fn latest(&self) -> Option<Reading> {
        self.latest
    }
}

impl Default for Thermometer {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading_at(celsius: f64) -> Reading {
        let mut thermometer = Thermometer::new();
        let exact = celsius * 0.01 / 5.0 * 1024.0;
        for n in 0..64 {
            assert_eq!(thermometer.latest(), None);
            // Noise of just over one step, evenly spread.
            thermometer.add((exact + f64::from(n) / 64.0) as u16);
        }
        thermometer.latest().unwrap()
    }

    #[test]
    fn temperatures_are_right_to_a_tenth_where_there_is_noise() {
        for celsius in [0.0, 0.3, 19.99, 24.5, 25.0, 36.6, 100.0, 150.0] {
            let reading = reading_at(celsius);
            assert!((f64::from(reading.kelvin_64ths()) / 64.0 - 273.15 - celsius).abs() < 0.1, "{celsius}");
            assert!((f64::from(reading.tenths_celsius()) / 10.0 - celsius).abs() < 0.1, "{celsius}");
            assert!((f64::from(reading.degrees()) - celsius).abs() <= 0.51, "{celsius}");
        }
    }

    #[test]
    fn degrees_stop_at_255_and_the_extremes_fit() {
        assert_eq!(Reading(0).degrees(), 0);
        assert_eq!(Reading(0).kelvin_64ths(), 17482);
        assert_eq!(Reading(64 * 1023).degrees(), 255);
        assert_eq!(Reading(64 * 1023).kelvin_64ths() / 64, 772);
    }
}
