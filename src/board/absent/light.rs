//! No light.

use super::chip::TC2;

/// Nothing.
pub struct Light;

impl Light {
    pub(super) fn new(_tc2: TC2) -> Self {
        Self
    }

    /// Does nothing.
    pub fn set(&mut self, _brightness: u8) {}
}
