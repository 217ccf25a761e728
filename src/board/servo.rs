//! The servo pulse, made by Timer1 alone: no interrupt, so no jitter.
//!
//! Fast PWM with ICR1 as TOP (mode 14): OC1B goes high at BOTTOM and low after a compare match with OCR1B, which Timer1 takes
//! over at BOTTOM only (ATmega48/88/168 datasheet 2545, section 15). So a new width begins with a period, whenever it is
//! written, and the pulse lasts OCR1B + 1 ticks.

use avr_device::atmega168::{PORTB, TC1};

use super::CLOCK_HZ;
use node::node::servo::Ticks;

const PRESCALER: u32 = 8;

/// Periods in a second.
const RATE_HZ: u32 = 50;

const TOP: u16 = {
    assert!(CLOCK_HZ / PRESCALER == 2_000_000, "a tick is half a microsecond");
    (CLOCK_HZ / PRESCALER / RATE_HZ - 1) as u16
};

/// The servo output: silent until it is first given a width.
pub struct Servo {
    tc1: TC1,
    width: Option<Ticks>,
}

impl Servo {
    pub(super) fn new(tc1: TC1, portb: &PORTB) -> Self {
        // After a restart the timer may be in a pulse: it is left to end, not cut. It is over in at most 2 ms; the turns, of
        // six cycles or more, are bounded all the same.
        for _ in 0..8000 {
            if tc1.tccr1a().read().com1b().is_disconnected() || portb.pinb().read().pb2().bit_is_clear() {
                break;
            }
        }
        // WGM11..0 = 2 and WGM13..2 = 3: mode 14. While COM1B is 0 the pin is an ordinary output, low.
        tc1.tccr1a().write(|w| w.wgm1().set(2));
        tc1.tccr1b().write(|w| w.wgm1().set(3));
        tc1.timsk1().write(|w| w.toie1().clear_bit());
        tc1.icr1().write(|w| w.set(TOP));
        tc1.tcnt1().write(|w| w.set(0));
        tc1.tccr1b().write(|w| w.wgm1().set(3).cs1().prescale_8());
        Self { tc1, width: None }
    }

    /// The width from the next period on. Nothing happens until the first one.
    pub fn set(&mut self, width: Option<Ticks>) {
        if width == self.width {
            return;
        }
        self.width = width;
        if let Some(Ticks(ticks)) = width {
            self.tc1.ocr1b().write(|w| w.set(ticks.wrapping_sub(1)));
            // OC1B's latch is low until the next BOTTOM, so that the first pulse is whole, too.
            self.tc1.tccr1a().write(|w| w.wgm1().set(2).com1b().match_clear());
        }
    }
}
