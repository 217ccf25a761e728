//! The push button on D4.

use avr_device::atmega168::PORTD;

/// The button, which pulls its pin low.
pub struct Button {
    portd: PORTD,
}

impl Button {
    pub(super) fn new(portd: PORTD) -> Self {
        Self { portd }
    }

    /// Whether it is pressed now, bouncing or not.
    pub fn is_pressed(&self) -> bool {
        self.portd.pind().read().pd4().bit_is_clear()
    }
}
