//! Numbers as a user writes them on a command line.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Reads a number of this range.
///
/// # Errors
/// If the text is none. The error says what to write.
pub fn parse_number<T>(text: &str, range: RangeInclusive<T>) -> Result<T, String>
where
    T: FromStr + PartialOrd + Display,
{
    let number = text.parse().ok().filter(|number| range.contains(number));
    number.ok_or_else(|| format!("use a number from {} to {}", range.start(), range.end()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_taken_within_its_range_and_the_error_has_the_range() {
        assert_eq!((parse_number("1", 1..=400), parse_number("400", 1..=400)), (Ok(1), Ok(400)));
        for wrong in ["0", "401", "-1", "", "x", "99999999999", "1.5"] {
            let error = parse_number::<u32>(wrong, 1..=400).unwrap_err();
            assert_eq!(error, "use a number from 1 to 400", "{wrong}");
        }
    }
}
