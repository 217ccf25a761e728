//! No button. Its pin has a pull-up all the same.

/// Nothing.
pub struct Button;

impl Button {
    pub(super) fn new(_pin: super::pins::ButtonSignal) -> Self {
        Self
    }

    /// False.
    pub fn is_pressed(&self) -> bool {
        false
    }
}
