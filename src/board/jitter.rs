//! Noise: how the watchdog's oscillator runs against the crystal (datasheet 2545, section 11.8).
//!
//! A time-out of 2,048 cycles of the oscillator, nominally 16 ms, lasts some 23,000 turns of the loop below. How many exactly
//! nobody can tell: an RC oscillator has jitter. The random generators for the Arduino that are built on it count on one bit a
//! time-out (W. Anderson's Entropy library makes 32 bits of 32 samples, endolith's "probably random" 8 of 8 and puts a raw
//! one at 4.4), and so does `node::store`.

use avr_device::atmega168::WDT;

/// The watchdog as a source of noise, before it is used as a watchdog.
pub struct Jitter {
    wdt: WDT,
}

impl Jitter {
    pub(super) fn new(wdt: WDT) -> Self {
        Self { wdt }
    }

    /// Counts through a time-out of the watchdog, 16 ms, and gives the lowest bits. Only before [`guard::start`], which takes
    /// the watchdog over.
    ///
    /// [`guard::start`]: super::guard::start
    pub fn sample(&mut self) -> u8 {
        // In interrupt mode, but with interrupts off: it only sets its flag, which a one clears.
        self.wdt.wdtcsr().write(|w| w.wdif().set_bit().wdie().set_bit());
        // A watchdog that stands still is given up after 45 ms.
        let mut turns = u16::MAX;
        while turns != 0 && self.wdt.wdtcsr().read().wdif().bit_is_clear() {
            turns -= 1;
        }
        turns as u8
    }
}
