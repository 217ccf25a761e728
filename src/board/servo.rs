//! The servo pulse, made by Timer1 alone: no interrupt, so no jitter.
//!
//! Fast PWM with ICR1 as TOP (mode 14): OC1B goes high at BOTTOM and low after a compare match with OCR1B, which Timer1 takes
//! over at BOTTOM only (ATmega48/88/168 datasheet 2545, section 15). So a new width begins with a period, whenever it is
//! written, and the pulse lasts OCR1B + 1 ticks.

use avr_device::atmega168::TC1;

use super::CLOCK_HZ;
use super::pins::ServoSignal;
use node::node::servo::{Output, Ticks, scaled};

const PRESCALER: u32 = 8;

/// Ticks in a second.
const TICKS: u32 = {
    assert!(CLOCK_HZ / PRESCALER == 2_000_000, "a tick is half a microsecond");
    CLOCK_HZ / PRESCALER
};

/// The servo output: silent until it is first given a width.
pub struct Servo {
    tc1: TC1,
    signal: ServoSignal,
    width: Ticks,
}

impl Servo {
    pub(super) fn new(tc1: TC1, signal: ServoSignal) -> Self {
        // After a restart the timer may be in a pulse: it is left to end, not cut. It is over in 2.5 ms; the turns, of
        // six cycles or more, are bounded all the same.
        let mut servo = Self { tc1, signal, width: 0 };
        let mut turns = 8000u16;
        while turns != 0 && !servo.is_idle() {
            turns = turns.wrapping_sub(1);
        }
        // WGM11..0 = 2 and WGM13..2 = 3: mode 14. While COM1B is 0 the pin is an ordinary output, low.
        servo.tc1.tccr1a().write(|w| w.wgm1().set(2));
        servo.tc1.tccr1b().write(|w| w.wgm1().set(3));
        servo.tc1.timsk1().write(|w| w.toie1().clear_bit());
        servo.tc1.tcnt1().write(|w| w.set(0));
        servo.set_rate(50);
        servo.tc1.tccr1b().write(|w| w.wgm1().set(3).cs1().prescale_8());
        servo
    }

    /// Pulses a second, 50 to 333. Before the first pulse: the timer must not be beyond its new end.
    pub fn set_rate(&mut self, rate_hz: u16) {
        self.tc1.icr1().write(|w| w.set(scaled((TICKS / 64) as u16, 64, rate_hz).wrapping_sub(1)));
        self.tc1.tcnt1().write(|w| w.set(0));
    }

    /// Not in a pulse.
    fn is_idle(&self) -> bool {
        !self.signal.is_driven_high()
    }
}

impl Output for Servo {
    #[inline(never)]
    fn set(&mut self, width: Ticks) {
        if width == self.width {
            return;
        }
        if width != 0 {
            self.tc1.ocr1b().write(|w| w.set(width.wrapping_sub(1)));
            // OC1B's latch is low until the next BOTTOM, so that the first pulse is whole, too.
            self.tc1.tccr1a().write(|w| w.wgm1().set(2).com1b().match_clear());
        } else if self.is_idle() {
            self.tc1.tccr1a().write(|w| w.wgm1().set(2));
        } else {
            return;
        }
        self.width = width;
    }
}
