//! The millisecond clock, from Timer0.

use super::chip::{CLOCK_HZ, TC0, interrupt};

const PRESCALER: u32 = 64;

/// TOP of Timer0: it counts from 0 to this in a millisecond.
pub const TOP: u8 = {
    assert!(CLOCK_HZ.is_multiple_of(PRESCALER * 1000));
    (CLOCK_HZ / PRESCALER / 1000 - 1) as u8
};

/// Milliseconds, modulo 256. One byte, so that the main loop can read it with interrupts enabled.
pub(super) static mut TICKS: u8 = 0;

interrupt!(TIMER0_COMPA {
    // Safety: the pointer is to a static. Only this handler writes it, and interrupts are disabled
    // in the handler.
    unsafe { (&raw mut TICKS).write_volatile(ticks().wrapping_add(1)) }
});

/// Reads the milliseconds, modulo 256. An `AtomicU8` would disable interrupts for the read, and a
/// byte does not need that.
fn ticks() -> u8 {
    // Safety: the pointer is to a static. One instruction reads a byte, so the value is never torn.
    // The read is volatile because the handler changes the byte between two reads.
    unsafe { (&raw const TICKS).read_volatile() }
}

/// The clock. It loses time if `tick` is not called for 256 ms; the watchdog restarts the program
/// before that, after 250 ms.
pub struct Clock {
    ticks: u8,
    now_ms: u16,
}

impl Clock {
    pub(super) fn new(tc0: TC0) -> Self {
        tc0.tccr0b.write(|w| w.cs0().no_clock());
        tc0.tccr0a.write(|w| w.wgm0().ctc());
        tc0.ocr0a.write(|w| w.bits(TOP));
        tc0.tcnt0.write(|w| w.bits(0));
        tc0.timsk0.write(|w| w.ocie0a().set_bit());
        tc0.tccr0b.write(|w| w.cs0().prescale_64());
        Self { ticks: ticks(), now_ms: 0 }
    }

    /// True if a millisecond or more has begun since the last [`tick`](Self::tick).
    pub fn has_ticked(&self) -> bool {
        ticks() != self.ticks
    }

    /// Adds the milliseconds that have begun since the last call to the time, and returns their
    /// number.
    pub fn tick(&mut self) -> u8 {
        let passed_ms = ticks().wrapping_sub(self.ticks);
        self.ticks = self.ticks.wrapping_add(passed_ms);
        self.now_ms = self.now_ms.wrapping_add(u16::from(passed_ms));
        passed_ms
    }

    /// Milliseconds since the start, modulo 65,536, as of the last [`tick`](Self::tick).
    pub fn now_ms(&self) -> u16 {
        self.now_ms
    }
}
