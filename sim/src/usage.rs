//! Errors of the command line, which have another exit code than errors of the machine.

use anyhow::Result;
use std::{error, fmt, io};

/// What is wrong with the command line, or with a file that it names.
#[derive(Debug)]
pub struct Usage(String);

impl fmt::Display for Usage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl error::Error for Usage {}

/// Marks the error of a result.
pub trait OrUsage {
    /// The result, whose error is the user's unless it comes from the operating system.
    fn or_usage(self) -> Self;
}

impl<T> OrUsage for Result<T> {
    fn or_usage(self) -> Result<T> {
        self.map_err(|error| match is_of_machine(&error) {
            true => error,
            false => Usage(format!("{error:#}")).into(),
        })
    }
}

fn is_of_machine(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| cause.is::<io::Error>())
}

/// Whether the user can put it right with another command line.
pub fn is_usage(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| cause.is::<Usage>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::{Context, anyhow};

    #[test]
    fn what_the_operating_system_reports_is_no_error_of_the_user() {
        let wrong: Result<()> = Err(anyhow!("--crystal 12: use 8 or 16")).or_usage();
        let error = wrong.context("uno").unwrap_err();
        assert!(is_usage(&error));
        assert_eq!(format!("{error:#}"), "uno: --crystal 12: use 8 or 16");
        let missing: Result<()> = Err(io::Error::from(io::ErrorKind::NotFound)).context("sketch.elf").or_usage();
        assert!(!is_usage(&missing.unwrap_err()));
    }
}
