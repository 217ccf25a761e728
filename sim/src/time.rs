//! Conversion of simulated time: from text such as "500ms", "5s", "2m" or "1h" to cycles, and from
//! cycles to seconds.

use bench::{Cycles, F_CPU_HZ};

/// Reads a duration with its unit: us, ms, s, m or h. Fractions are allowed ("1.5s").
///
/// # Errors
/// If `text` is not a duration; the message says which texts are accepted.
pub fn parse_duration(text: &str) -> Result<Cycles, String> {
    let seconds = sim_base::parse_seconds(text)?;
    Ok((seconds * F_CPU_HZ as f64).round() as Cycles)
}

/// Converts cycles to seconds.
pub fn seconds(cycles: Cycles) -> f64 {
    cycles as f64 / F_CPU_HZ as f64
}

/// Converts cycles to microseconds.
pub fn micros(cycles: Cycles) -> f64 {
    cycles as f64 * 1e6 / F_CPU_HZ as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_duration_can_have_every_unit() {
        let cases = [
            ("250us", 4_000),
            ("500ms", F_CPU_HZ / 2),
            ("5s", 5 * F_CPU_HZ),
            ("1.5s", F_CPU_HZ * 3 / 2),
            ("2m", 120 * F_CPU_HZ),
            ("1h", 3600 * F_CPU_HZ),
            ("0s", 0),
        ];
        for (text, cycles) in cases {
            assert_eq!(parse_duration(text), Ok(cycles), "{text}");
        }
    }
}
