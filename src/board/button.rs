//! The push button.

use super::pins::ButtonSignal;

/// The button. It pulls its pin low while it is pressed.
pub struct Button {
    signal: ButtonSignal,
}

impl Button {
    pub(super) fn new(signal: ButtonSignal) -> Self {
        Self { signal }
    }

    /// True if the button is pressed now. Not debounced.
    pub fn is_pressed(&self) -> bool {
        self.signal.is_pulled_low()
    }
}
