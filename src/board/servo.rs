//! The servo pulse. Timer1 makes it without an interrupt, so it has no jitter.
//!
//! Timer1 is in fast PWM mode with ICR1 as TOP (mode 14): OC1x goes high at BOTTOM, and low after a compare match with OCR1x. OCR1x is double
//! buffered and updated only at BOTTOM (ATmega48/88/168 datasheet 2545, section 15). So a new width takes effect at the start of a
//! period, and the pulse lasts OCR1x + 1 ticks. The servo is on OC1A (D9) or OC1B (D10).

use super::chip::TC1;

use super::CLOCK_HZ;
use super::pins::ServoSignal;
use node::hardware::SERVO;
use node::node::parameters::{Parameter, Parameters};
use node::node::servo::{Output, Ticks, scaled};

/// Whether the servo is on OC1A, and not on OC1B.
const IS_A: bool = SERVO.bit == 1;

const PRESCALER: u32 = 8;

/// Ticks in a second.
const TICKS: u32 = {
    assert!(CLOCK_HZ / PRESCALER == 2_000_000, "a tick is half a microsecond");
    CLOCK_HZ / PRESCALER
};

/// The servo output. It makes no pulse before the first [`set`](Output::set).
pub struct Servo {
    tc1: TC1,
    signal: ServoSignal,
    width: Ticks,
}

impl Servo {
    pub(super) fn new(tc1: TC1, signal: ServoSignal) -> Self {
        // After a restart of the program the timer may be in a pulse. The pulse must end and not be cut; it takes 2.5 ms at most. The loop has a
        // limit all the same: 8,000 turns of six cycles or more are 3 ms.
        let mut servo = Self { tc1, signal, width: 0 };
        let mut turns = 8000u16;
        while turns != 0 && !servo.is_idle() {
            turns = turns.wrapping_sub(1);
        }
        // WGM11..0 = 2 and WGM13..2 = 3: mode 14. While COM1x is 0, the port drives the pin low.
        servo.tc1.tccr1a().write(|w| w.wgm1().set(2));
        servo.tc1.tccr1b().write(|w| w.wgm1().set(3));
        servo.tc1.timsk1().write(|w| w.toie1().clear_bit());
        servo.tc1.tcnt1().write(|w| w.set(0));
        servo.set_rate(50);
        servo.tc1.tccr1b().write(|w| w.wgm1().set(3).cs1().prescale_8());
        servo
    }

    /// Takes over the rate. Call it before the first pulse.
    pub fn start(&mut self, parameters: &Parameters) {
        self.set_rate(parameters.get(Parameter::OutRate));
    }

    /// Sets the rate in pulses a second, 50 to 333. Call it before the first pulse: it restarts the period, so that the timer is never above the new
    /// TOP.
    fn set_rate(&mut self, rate_hz: u16) {
        self.tc1.icr1().write(|w| w.set(scaled((TICKS / 64) as u16, 64, rate_hz).wrapping_sub(1)));
        self.tc1.tcnt1().write(|w| w.set(0));
    }

    /// True if no pulse is active.
    fn is_idle(&self) -> bool {
        !self.signal.is_driven_high()
    }
}

impl Output for Servo {
    #[inline(never)]
    fn set(&mut self, _output: usize, width: Ticks) {
        if width == self.width {
            return;
        }
        if width != 0 {
            if IS_A {
                self.tc1.ocr1a().write(|w| w.set(width.wrapping_sub(1)));
            } else {
                self.tc1.ocr1b().write(|w| w.set(width.wrapping_sub(1)));
            }
            // OC1x stays low until the next BOTTOM, so the first pulse has its full width, too.
            self.tc1.tccr1a().write(|w| {
                let w = w.wgm1().set(2);
                if IS_A { w.com1a().match_clear() } else { w.com1b().match_clear() }
            });
        } else if self.is_idle() {
            self.tc1.tccr1a().write(|w| w.wgm1().set(2));
        } else {
            return;
        }
        self.width = width;
    }
}
