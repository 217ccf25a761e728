//! No debug.LogMessage.

use crate::monitor::Line;

/// False.
pub const IS_THERE: bool = false;

/// Nothing.
#[derive(Default)]
pub struct Log;

impl Log {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// True.
    pub fn has_room(&self, _now_ms: u16) -> bool {
        true
    }

    /// Does nothing.
    pub fn push(&mut self, _character: u8, _line: Line, _now_ms: u16) {}

    /// False.
    pub fn is_due(&self, _now_ms: u16) -> bool {
        false
    }

    /// Does nothing.
    pub fn take(&mut self, _now_ms: u16, _put: impl FnMut(u8)) {}
}
