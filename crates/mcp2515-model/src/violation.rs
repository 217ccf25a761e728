//! Driver mistakes: what the datasheet forbids, advises against, or ignores.
//!
//! A driver that follows the datasheet causes none. The chip itself does not report them; the model
//! records them so that a test can fail.

use std::fmt;

use sim_base::Cycles;

/// A driver mistake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// When its SPI byte ended, or CS rose.
    pub at: Cycles,
    /// Register, value, rule and datasheet section.
    pub text: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cycle {}: {}", self.at, self.text)
    }
}

/// Driver mistakes that were not read yet. A driver in a loop can make millions: the first ones are
/// enough, so those beyond `CAPACITY` are dropped.
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
