//! Milliseconds, from Timer0.

use avr_device::atmega168::TC0;

use super::CLOCK_HZ;

const PRESCALER: u32 = 64;

/// Timer0 counts from 0 to this in a millisecond.
const TOP: u8 = {
    assert!(CLOCK_HZ.is_multiple_of(PRESCALER * 1000));
    (CLOCK_HZ / PRESCALER / 1000 - 1) as u8
};

/// Milliseconds, modulo 256. One byte, so that it can be read while the interrupt may come.
static mut TICKS: u8 = 0;

#[avr_device::interrupt(atmega168)]
fn TIMER0_COMPA() {
    // Safety: only this handler writes it, and it is not interrupted.
    unsafe { (&raw mut TICKS).write_volatile(ticks().wrapping_add(1)) }
}

/// An `AtomicU8` would be read with interrupts held back, which a byte does not need.
#[inline(always)]
fn ticks() -> u8 {
    // Safety: a byte is read at once. Volatile, because it changes in between.
    unsafe { (&raw const TICKS).read_volatile() }
}

/// The clock. It loses time when it is not polled for 256 ms; the watchdog steps in before.
pub struct Clock {
    ticks: u8,
    now_ms: u16,
}

impl Clock {
    pub(super) fn new(tc0: TC0) -> Self {
        tc0.tccr0b().write(|w| w.cs0().no_clock());
        tc0.tccr0a().write(|w| w.wgm0().ctc());
        tc0.ocr0a().write(|w| w.set(TOP));
        tc0.tcnt0().write(|w| w.set(0));
        tc0.timsk0().write(|w| w.ocie0a().set_bit());
        tc0.tccr0b().write(|w| w.cs0().prescale_64());
        Self { ticks: ticks(), now_ms: 0 }
    }

    /// Whether a millisecond or more has begun since the last [`tick`](Self::tick).
    #[inline(always)]
    pub fn has_ticked(&self) -> bool {
        ticks() != self.ticks
    }

    /// Takes note of the milliseconds that have begun since the last call: how many.
    pub fn tick(&mut self) -> u8 {
        let passed_ms = ticks().wrapping_sub(self.ticks);
        self.ticks = self.ticks.wrapping_add(passed_ms);
        self.now_ms = self.now_ms.wrapping_add(u16::from(passed_ms));
        passed_ms
    }

    /// Milliseconds since the start, modulo 65,536, as of the last [`tick`](Self::tick).
    #[inline(always)]
    pub fn now_ms(&self) -> u16 {
        self.now_ms
    }
}
