//! The temperature sensor LM35: 10 mV per degree Celsius, and 0 V below 0 °C without a negative
//! supply (its datasheet).
//!
//! For another sensor, write a file like this one, and change the line `use crate::lm35 as sensor`
//! in `board.rs`.

const MICROVOLTS_PER_DEGREE: f64 = 10_000.0;

/// Output voltage in microvolts at a temperature in degrees Celsius.
pub fn microvolts(celsius: f64) -> u32 {
    (celsius.max(0.0) * MICROVOLTS_PER_DEGREE).round() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_degree_is_10_mv_from_0_degrees_on() {
        assert_eq!([25.0, 0.0, -10.0].map(microvolts), [250_000, 0, 0]);
    }
}
