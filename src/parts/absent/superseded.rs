//! No count of superseded commands. With one output it would take 86 bytes of the ATmega168.

use crate::monitor::Monitor;

/// Nothing.
#[derive(Default)]
pub struct Superseded;

impl Superseded {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// Does nothing.
    pub fn count(&mut self) {}

    /// Does nothing.
    pub fn second(&mut self, _: &mut Monitor) {}

    /// Does nothing.
    pub fn report(&self, _: &mut Monitor) {}
}
