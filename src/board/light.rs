//! The light on OC2B, dimmed by Timer2 without software.
//!
//! Phase-correct PWM (mode 1) at 490 Hz: constantly off at 0 and constantly on at 255
//! (ATmega48/88/168 datasheet 2545, section 17).

use super::chip::TC2;

const _: () = assert!(
    firmware::hardware::LIGHT.is_some(),
    "INT on D3, or the feature rpm, takes the light's pin: leave out the feature lights"
);

/// The light.
pub struct Light {
    tc2: TC2,
}

impl Light {
    pub(super) fn new(tc2: TC2) -> Self {
        tc2.ocr2b.write(|w| w.bits(0));
        tc2.tccr2a.write(|w| w.com2b().match_clear().wgm2().pwm_phase());
        tc2.tccr2b.write(|w| w.cs2().prescale_64());
        Self { tc2 }
    }

    /// Sets the brightness: 0 is off, 255 is full.
    pub fn set(&mut self, brightness: u8) {
        self.tc2.ocr2b.write(|w| w.bits(brightness));
    }
}
