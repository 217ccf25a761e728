//! Noise: how the watchdog's oscillator runs against the crystal.

use avr_device::atmega168::WDT;

/// The watchdog as a source of noise, before it is used as a watchdog.
pub struct Jitter {
    wdt: WDT,
}

impl Jitter {
    pub(super) fn new(wdt: WDT) -> Self {
        Self { wdt }
    }

    /// Counts through a time-out of the watchdog, 16 ms, and gives the lowest bits.
    pub fn sample(&mut self) -> u8 {
        // Interrupts are off: it only sets its flag.
        self.wdt.wdtcsr().write(|w| w.wdif().set_bit().wdie().set_bit());
        let mut turns = u16::MAX;
        while turns != 0 && self.wdt.wdtcsr().read().wdif().bit_is_clear() {
            turns -= 1;
        }
        turns as u8
    }
}
