//! The monitor of a program without lines of text: whatever is logged goes nowhere.

use super::{Line, TextsAndNames};

/// Nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event;

impl Event {
    /// Nothing.
    pub const fn new(_line: Line) -> Self {
        Self
    }

    /// Does nothing.
    pub fn set_source(&mut self, _source: u8) {}

    /// Does nothing.
    pub fn set_transfer(&mut self, _transfer: u8) {}

    /// Does nothing.
    pub fn set_code(&mut self, _code: u8) {}

    /// Does nothing.
    pub fn set_line(&mut self, _line: Line) {}

    /// Does nothing.
    pub fn set_a(&mut self, _a: u16) {}

    /// Does nothing.
    pub fn set_b(&mut self, _b: u16) {}
}

/// Takes events, and forgets them.
pub struct Monitor {
    event: Event,
}

impl Monitor {
    /// A monitor.
    pub const fn new() -> Self {
        Self { event: Event }
    }

    /// Returns an event for values that nobody reads.
    pub fn log_line(&mut self, _line: Line) -> &mut Event {
        &mut self.event
    }

    /// The same for a line about a single frame.
    pub fn log_frame(&mut self, _line: Line) -> Option<&mut Event> {
        None
    }

    /// True.
    pub fn is_between_lines(&self) -> bool {
        true
    }

    /// An event for values that nobody reads.
    pub fn next_event(&mut self) -> &mut Event {
        &mut self.event
    }

    /// Does nothing.
    pub fn send_first(&mut self) {}

    /// There is no character to send.
    pub fn next_byte<F: TextsAndNames>(&mut self, _flash: F) -> u8 {
        0
    }
}
