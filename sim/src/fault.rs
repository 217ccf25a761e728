//! Faults of the command line: `--inject NAME@TIME`.

use crate::time::{parse_duration, seconds};
use bench::Cycles;
use std::fmt;
use std::str::FromStr;

pub use bench::fault::{ALL, Fault, table};

/// A fault and its simulated time, "NAME@TIME" on the command line. If a lasting fault is named
/// twice, it ends at the second time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Injection {
    pub at: Cycles,
    pub fault: Fault,
}

impl FromStr for Injection {
    type Err = String;

    fn from_str(text: &str) -> Result<Injection, String> {
        let (name, time) = text
            .split_once('@')
            .ok_or_else(|| format!("\"{text}\" has no time: write for example reset@2s"))?;
        Ok(Injection { fault: name.parse()?, at: parse_duration(time)? })
    }
}

impl fmt::Display for Injection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}s", self.fault, seconds(self.at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench::F_CPU_HZ;

    #[test]
    fn an_injection_is_a_name_and_a_time() {
        let injection = "chip-reset@1.5s".parse::<Injection>().unwrap();
        assert_eq!(injection.fault, Fault::ChipReset);
        assert_eq!(injection.at, F_CPU_HZ * 3 / 2);
        for text in ["chip-reset", ""] {
            let error = text.parse::<Injection>().unwrap_err();
            assert!(error.ends_with("has no time: write for example reset@2s"), "{error}");
        }
        let error = "gremlins@1s".parse::<Injection>().unwrap_err();
        assert!(error.contains("no-ack"), "{error}");
    }
}
