//! Random bits from the jitter of the watchdog's oscillator against the crystal (datasheet 2545,
//! section 11.8).
//!
//! The watchdog's timeout is 2,048 cycles of its RC oscillator, nominally 16 ms. The loop below
//! counts about 23,000 turns in that time, and the jitter of the oscillator makes the exact number
//! random. Random generators for the Arduino that use this jitter assume one random bit for
//! each timeout: W. Anderson's Entropy library makes 32 bits of 32 samples, and endolith's
//! "probably random" 8 bits of 8 samples, although it estimates 4.4 bits in a raw sample.
//! `firmware::node::store` assumes one bit, too.

use super::chip::WDT;

/// The watchdog as a source of random bits, before its use as a watchdog.
pub struct Jitter {
    wdt: WDT,
}

impl Jitter {
    pub(super) fn new(wdt: WDT) -> Self {
        Self { wdt }
    }

    /// Counts during one timeout of the watchdog, 16 ms, and returns the lowest eight bits. Call it
    /// only before [`guard::start`], which uses the watchdog from then on.
    ///
    /// [`guard::start`]: super::guard::start
    pub fn sample(&mut self) -> u8 {
        // Interrupt mode, with interrupts disabled: the timeout only sets WDIF. Writing a 1 clears
        // WDIF.
        self.wdt.wdtcsr.write(|w| w.wdif().set_bit().wdie().set_bit());
        // If the watchdog does not run, the loop ends after 45 ms.
        let mut turns = u16::MAX;
        while turns != 0 && self.wdt.wdtcsr.read().wdif().bit_is_clear() {
            turns -= 1;
        }
        turns as u8
    }
}
