//! The push button on D4.

use super::pins::ButtonSignal;

/// The button, which pulls its pin low.
pub struct Button {
    signal: ButtonSignal,
}

impl Button {
    pub(super) fn new(signal: ButtonSignal) -> Self {
        Self { signal }
    }

    /// Whether it is pressed now, bouncing or not.
    pub fn is_pressed(&self) -> bool {
        self.signal.is_pulled_low()
    }
}
