//! Driver mistakes: what the datasheet forbids, asks not to do, or lets have no effect.
//!
//! A driver that keeps to the datasheet never causes one. The chip itself has no such report; the model
//! keeps it so that a test can fail on it.

use std::fmt;

use sim_base::Cycles;

/// One mistake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// When the SPI byte ended, or CS rose, that made it.
    pub at: Cycles,
    /// Register, value, rule and datasheet section.
    pub text: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cycle {}: {}", self.at, self.text)
    }
}

/// Mistakes that were not read yet. A driver in a loop can make millions: the first ones are enough, so those beyond
/// `CAPACITY` are dropped.
#[derive(Debug, Default)]
pub(super) struct Violations(Vec<Violation>);

impl Violations {
    const CAPACITY: usize = 1000;

    pub(super) fn record(&mut self, at: Cycles, text: String) {
        if self.0.len() < Self::CAPACITY {
            self.0.push(Violation { at, text });
        }
    }

    pub(super) fn take(&mut self) -> Vec<Violation> {
        std::mem::take(&mut self.0)
    }
}
