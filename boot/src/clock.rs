//! Seconds, from Timer1.

use crate::registers::{CS12_CS10, OCF1A, OCR1AH, OCR1AL, TCCR1B, TIFR1, WGM12};

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
