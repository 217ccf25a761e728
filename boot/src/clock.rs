//! Seconds, from Timer1, and the watchdog.

use core::arch::asm;

use crate::registers::{
    CS12_CS10, OCF1A, OCR1AH, OCR1AL, TCCR1B, TIFR1, WDCE, WDE, WDP2_WDP1, WGM12,
};
use crate::variables::RESTART_COUNT;

/// Each of the two bytes of TOP of Timer1. It counts to that in a second and three milliseconds, at
/// 16 MHz / 1024: so three of them are three seconds of listening, before which the controller
/// needs a millisecond to start.
const TOP: u8 = (16_000_000u32 / 1024 / 256) as u8;

/// Starts the clock.
#[inline(always)]
pub fn start() {
    OCR1AH.write(TOP);
    // The chip takes the high byte over with the low one.
    OCR1AL.write(TOP);
    TCCR1B.write(WGM12 | CS12_CS10);
}

/// True once a second.
#[inline(always)]
pub fn take_second() -> bool {
    let has_passed = TIFR1.has(OCF1A);
    if has_passed {
        // Writing 1 clears the flag.
        TIFR1.set(OCF1A);
    }
    has_passed
}

/// The time until the watchdog resets the chip.
#[repr(u8)]
pub enum Timeout {
    /// It does not.
    Never = 0,
    /// 16 ms, which is enough to send an answer.
    Soon = WDE,
    /// A second.
    Second = WDE | WDP2_WDP1,
}

/// Sets the watchdog. Its next reset does not count as one of the program.
#[inline(never)]
pub fn set_watchdog(timeout: Timeout) {
    // The reset makes this 0.
    RESTART_COUNT.write(u8::MAX);
    // WDE changes only within four cycles after WDCE is set (datasheet 11.8.2).
    // SAFETY: the block writes only WDTCSR, at 0x60.
    unsafe {
        asm!(
            "wdr",
            "sts 0x60, {change}",
            "sts 0x60, {value}",
            change = in(reg) WDCE | WDE,
            value = in(reg) timeout as u8,
            options(nostack, preserves_flags)
        );
    }
}
