//! Durations as a user writes them on a command line: "500ms", "5s", "2m", "1h".

/// A limit beyond any run, and within the range of all types that count time.
const TEN_YEARS_S: f64 = 10.0 * 365.25 * 86_400.0;

/// The seconds of a duration with its unit: us, ms, s, m or h. It may have a fraction ("1.5s").
///
/// # Errors
/// If the text is not such a duration. The error says what to write.
pub fn parse_seconds(text: &str) -> Result<f64, String> {
    let text = text.trim();
    if text.starts_with('-') {
        return Err(format!("\"{text}\" is negative: write for example 500ms, 5s, 2m or 1h"));
    }
    let unit_at = text.find(|c: char| !c.is_ascii_digit() && c != '.').ok_or_else(|| {
        format!("\"{text}\" has no unit: write {text}s, {text}ms, {text}m or {text}h")
    })?;
    let (number, unit) = text.split_at(unit_at);
    let seconds = match unit {
        "us" => 1e-6,
        "ms" => 1e-3,
        "s" => 1.0,
        "m" => 60.0,
        "h" => 3600.0,
        other => return Err(format!("unknown unit \"{other}\": use us, ms, s, m or h")),
    };
    let number: f64 = number.parse().map_err(|_| {
        format!("\"{text}\" is not a duration: write for example 500ms, 5s, 2m or 1h")
    })?;
    match number * seconds {
        seconds if seconds > TEN_YEARS_S => Err(format!("\"{text}\" is longer than ten years")),
        seconds => Ok(seconds),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_accept_every_unit() {
        let cases = [
            ("250us", 250e-6),
            ("500ms", 0.5),
            ("5s", 5.0),
            ("1.5s", 1.5),
            ("2m", 120.0),
            ("1h", 3600.0),
            ("0s", 0.0),
        ];
        for (text, seconds) in cases {
            let parsed = parse_seconds(text).unwrap();
            assert!((parsed - seconds).abs() < 1e-9, "{text}: {parsed}");
        }
    }

    #[test]
    fn wrong_durations_are_answered_with_an_example() {
        for text in ["", "5", "s", "5 s", "5d", "-5s", "1.2.3s", "999999h"] {
            assert!(parse_seconds(text).is_err(), "{text}");
        }
        assert!(parse_seconds("5").unwrap_err().contains("5s"));
        assert!(parse_seconds("5d").unwrap_err().contains("ms"));
    }
}
