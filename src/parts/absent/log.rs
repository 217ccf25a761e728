//! No debug.LogMessage.

use crate::monitor::Change;
use crate::tables::condition::Conditions;

/// Nothing.
#[derive(Default)]
pub struct Log;

impl Log {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// `None`.
    pub fn begin(&mut self, _now: Conditions, _now_ms: u16) -> Option<Change> {
        None
    }

    /// False.
    pub fn push(&mut self, _character: u8) -> bool {
        false
    }

    /// False.
    pub fn is_due(&self) -> bool {
        false
    }

    /// False.
    pub fn take(&mut self, _now: Conditions, _now_ms: u16, _put: impl FnMut(u8)) -> bool {
        false
    }

    /// Does nothing.
    pub fn tell_again(&mut self, _conditions: Conditions) {}
}
