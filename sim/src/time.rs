//! Simulated time as a person writes and reads it: "500ms", "5s", "2m", "1h" in, seconds with microseconds out.

use bench::{Cycles, F_CPU_HZ};

/// Reads a duration with its unit: us, ms, s, m or h. Fractions are allowed ("1.5s").
///
/// # Errors
/// A text that says what is accepted.
pub fn parse_duration(text: &str) -> Result<Cycles, String> {
    let text = text.trim();
    if text.starts_with('-') {
        return Err(format!("\"{text}\" is negative: write for example 500ms, 5s, 2m or 1h"));
    }
    let unit_at = text
        .find(|c: char| !c.is_ascii_digit() && c != '.')
        .ok_or_else(|| format!("\"{text}\" has no unit: write {text}s, {text}ms, {text}m or {text}h"))?;
    let (number, unit) = text.split_at(unit_at);
    let seconds = match unit {
        "us" => 1e-6,
        "ms" => 1e-3,
        "s" => 1.0,
        "m" => 60.0,
        "h" => 3600.0,
        other => return Err(format!("unknown unit \"{other}\": use us, ms, s, m or h")),
    };
    let number: f64 =
        number.parse().map_err(|_| format!("\"{text}\" is no duration: write for example 500ms, 5s, 2m or 1h"))?;
    let cycles = number * seconds * F_CPU_HZ as f64;
    // Ten years: far beyond any run, and far from the end of the type.
    if cycles > 10.0 * 365.25 * 86_400.0 * F_CPU_HZ as f64 {
        return Err(format!("\"{text}\" is longer than ten years"));
    }
    Ok(cycles.round() as Cycles)
}

/// Simulated time in seconds.
pub fn seconds(cycles: Cycles) -> f64 {
    cycles as f64 / F_CPU_HZ as f64
}

/// Simulated time in microseconds.
pub fn micros(cycles: Cycles) -> f64 {
    cycles as f64 * 1e6 / F_CPU_HZ as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_take_every_unit() {
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

    #[test]
    fn wrong_durations_say_what_would_be_right() {
        for text in ["", "5", "s", "5 s", "5d", "-5s", "1.2.3s", "999999h"] {
            assert!(parse_duration(text).is_err(), "{text}");
        }
        assert!(parse_duration("5").unwrap_err().contains("5s"));
        assert!(parse_duration("5d").unwrap_err().contains("ms"));
    }
}
