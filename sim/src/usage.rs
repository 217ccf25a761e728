//! Errors of the command line. Their exit code differs from that of errors of the operating system.

use anyhow::Result;
use sim_base::parse_number;
use std::ops::RangeInclusive;
use std::str::FromStr;
use std::{error, fmt, io};

/// An error in the command line, or in the contents of a file that it names.
#[derive(Debug)]
pub struct Usage(String);

impl fmt::Display for Usage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl error::Error for Usage {}

/// Marks errors as [`Usage`].
pub trait OrUsage {
    /// Converts an error to [`Usage`], unless the operating system caused it.
    fn or_usage(self) -> Self;
}

impl<T> OrUsage for Result<T> {
    fn or_usage(self) -> Result<T> {
        self.map_err(|error| match is_from_system(&error) {
            true => error,
            false => Usage(format!("{error:#}")).into(),
        })
    }
}

/// The parser of an option that takes a number.
pub fn within<T>(range: RangeInclusive<T>) -> impl Fn(&str) -> Result<T, String> + Clone
where
    T: FromStr + PartialOrd + fmt::Display + Clone,
{
    move |text| parse_number(text, range.clone())
}

fn is_from_system(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| cause.is::<io::Error>())
}

/// True if the user can correct the error with another command line.
pub fn is_usage(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| cause.is::<Usage>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::{Context, anyhow};

    #[test]
    fn an_error_of_the_operating_system_is_not_a_usage_error() {
        let wrong: Result<()> = Err(anyhow!("--crystal 12: use 8 or 16")).or_usage();
        let error = wrong.context("uno").unwrap_err();
        assert!(is_usage(&error));
        assert_eq!(format!("{error:#}"), "uno: --crystal 12: use 8 or 16");
        let missing: Result<()> =
            Err(io::Error::from(io::ErrorKind::NotFound)).context("sketch.elf").or_usage();
        assert!(!is_usage(&missing.unwrap_err()));
    }
}
