//! No safety switch: it is always off.

use crate::tables::parameters::Parameters;

/// Nothing.
#[derive(Default)]
pub struct Safety;

impl Safety {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// False.
    pub fn is_safe(&self) -> bool {
        false
    }

    /// False.
    pub fn is_safe_by(&self, _source: u8) -> bool {
        false
    }

    /// Does nothing.
    pub fn begin(&mut self, _source: u8) {}

    /// False.
    pub fn ends_pulses(&self, _parameters: &Parameters) -> bool {
        false
    }

    /// Does nothing.
    pub fn end(&mut self) {}

    /// False.
    pub fn second(&mut self) -> bool {
        false
    }
}
