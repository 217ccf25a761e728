//! The temperature sensor LM35: 10 mV per degree Celsius, and nothing below 0 °C without a negative supply (its datasheet).
//!
//! Another sensor is a file like this one, and the line in `board.rs` that says which is wired.

const MICROVOLTS_PER_DEGREE: f64 = 10_000.0;

/// The voltage at a temperature.
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
