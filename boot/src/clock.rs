//! Seconds, from Timer1.

use crate::registers::{CS12_CS10, OCF1A, OCR1AH, OCR1AL, TCCR1B, TIFR1, WGM12};

/// TOP of Timer1: it counts from 0 to this in a second, at 16 MHz / 1024.
const TOP: [u8; 2] = (16_000_000u32 / 1024 - 1).to_le_bytes().first_chunk::<2>().copied().unwrap();

/// Starts the clock.
#[inline(always)]
pub fn start() {
    OCR1AH.write(TOP[1]);
    OCR1AL.write(TOP[0]);
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
