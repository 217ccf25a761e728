//! Timer1, which makes the pulse of output 1 without an interrupt, so it has no jitter.
//!
//! Timer1 is in fast PWM mode with ICR1 as TOP (mode 14): OC1x goes high at BOTTOM, and low after a
//! compare match with OCR1x. OCR1x is double buffered and updated only at BOTTOM (ATmega48/88/168
//! datasheet 2545, section 15). So a new width takes effect at the start of a period, and the pulse
//! lasts OCR1x + 1 ticks. The servo is on OC1A (D9) or OC1B (D10).

use super::chip::{CLOCK_HZ, TC1};
use super::pins::ServoSignal;
use firmware::hardware::SERVO;
use firmware::math::scaled;
use firmware::parts::outputs::travel::Ticks;

/// Whether the servo is on OC1A, and not on OC1B.
const IS_A: bool = SERVO.bit == 1;

const PRESCALER: u32 = 8;

/// Ticks in a second.
pub const TICKS: u32 = {
    assert!(CLOCK_HZ / PRESCALER == 2_000_000, "a tick is half a microsecond");
    CLOCK_HZ / PRESCALER
};

/// Turns of six cycles or more that are longer than any pulse, which takes 2.5 ms at most: 3 ms.
pub const TURNS_OF_A_PULSE: u16 = 8000;

/// Stops the timer between two pulses, in mode 14. After a restart of the program it may be in a
/// pulse, which must end and not be cut.
pub fn stop(tc1: &TC1, signal: &ServoSignal) {
    let mut turns = TURNS_OF_A_PULSE;
    // Two conditions in one `while` take 14 bytes more.
    while signal.is_driven_high() {
        turns = turns.wrapping_sub(1);
        if turns == 0 {
            break;
        }
    }
    // WGM11..0 = 2 and WGM13..2 = 3: mode 14. While COM1x is 0, the port drives the pin low.
    tc1.tccr1a.write(|w| w.wgm1().bits(2));
    tc1.tccr1b.write(|w| w.wgm1().bits(3));
    tc1.timsk1.write(|w| w.toie1().clear_bit());
}

/// Lets the timer run.
pub fn run(tc1: &TC1) {
    tc1.tccr1b.write(|w| w.wgm1().bits(3).cs1().prescale_8());
}

/// Ticks of a period at a rate in pulses a second, 50 to 333.
pub fn period(rate_hz: u16) -> Ticks {
    scaled((TICKS / 64) as u16, 64, rate_hz)
}

/// Sets the period, and begins one, so that the timer is never above the new TOP. Call it before
/// the first pulse.
pub fn set_period(tc1: &TC1, period: Ticks) {
    tc1.icr1.write(|w| w.bits(period.wrapping_sub(1)));
    tc1.tcnt1.write(|w| w.bits(0));
}

/// Makes pulses of this width from the next period on, or none. Between two pulses only, if it is
/// 0.
pub fn set_width(tc1: &TC1, width: Ticks) {
    if width == 0 {
        tc1.tccr1a.write(|w| w.wgm1().bits(2));
        return;
    }
    if IS_A {
        tc1.ocr1a.write(|w| w.bits(width.wrapping_sub(1)));
    } else {
        tc1.ocr1b.write(|w| w.bits(width.wrapping_sub(1)));
    }
    // OC1x stays low until the next BOTTOM, so the first pulse has its full width, too.
    tc1.tccr1a.write(|w| {
        let w = w.wgm1().bits(2);
        if IS_A { w.com1a().match_clear() } else { w.com1b().match_clear() }
    });
}
