//! The watchdog's oscillator, and the flag WDIF (datasheet section 11.8).
//!
//! simavr's watchdog counts exactly 125 CPU cycles for each cycle of its oscillator. This model
//! takes the time-outs of [`WatchdogOscillator`].
//!
//! In simavr a program cannot clear WDIF by writing a one to it. In this model it can.

use std::cell::RefCell;

use super::analog::WatchdogOscillator;
use super::base::{Base, Peripheral};
use super::chip::Chip;
use super::core::{Core, Vector};
use super::regs::{WDE, WDIE, WDIF, WDP, WDTCSR};
use super::silicon::Silicon;
use sim_base::Noise;

/// The watchdog of one chip.
#[derive(Debug)]
pub(super) struct Watchdog {
    oscillator: WatchdogOscillator,
}

impl Peripheral for RefCell<Watchdog> {
    fn for_chip(_: Chip) -> RefCell<Watchdog> {
        RefCell::new(Watchdog::new(0))
    }

    fn writes(&self) -> &'static [u16] {
        &[WDTCSR]
    }

    fn write(&self, base: &Base, address: u16, value: u8) {
        let before = base.core.get(address);
        base.forward(address, value);
        self.borrow_mut().handle_write(&base.core, before, value);
    }

    fn reset(&self, base: &Base, _: &mut Noise) {
        self.borrow_mut().reset(base);
    }
}

impl Watchdog {
    /// The watchdog of a chip with this seed.
    pub fn new(seed: u64) -> Watchdog {
        Watchdog { oscillator: WatchdogOscillator::new(seed) }
    }

    /// Sets the values of the chip.
    pub fn tune(&mut self, silicon: &Silicon) {
        self.oscillator.tune(silicon);
    }

    /// Handles a write of `value` to WDTCSR, which had the value `before`, after simavr's own
    /// handler.
    fn handle_write(&mut self, core: &Core, before: u8, value: u8) {
        let mut after = core.get(WDTCSR);
        // > WDIF is cleared by writing a logic one to the flag. (section 11.9.2)
        after = after & !WDIF | before & !value & WDIF;
        core.set(WDTCSR, after);
        if before & value & WDIF != 0 {
            core.withdraw(Vector::Watchdog);
        }
        let enabled = after & (WDE | WDIE) != 0;
        core.set_watchdog_cycles(self.oscillator.time_out(after));
        // If the length of the time-out changes, simavr keeps the end of the running one. This
        // model restarts it, as for programs that execute WDR before the change, which the
        // datasheet demands.
        if enabled && (before & (WDE | WDIE) == 0 || (before ^ after) & WDP != 0) {
            core.restart_watchdog();
        }
    }

    /// Handles the end of a time-out: sets the length of the next one.
    pub fn timed_out(&mut self, core: &Core) {
        core.set_watchdog_cycles(self.oscillator.time_out(core.get(WDTCSR)));
    }

    /// Handles a reset of the chip. After a reset by the watchdog, the watchdog keeps running; its
    /// time-out begins when the chip has started.
    fn reset(&mut self, base: &Base) {
        let core = &base.core;
        if core.get(WDTCSR) & WDE == 0 {
            return self.timed_out(core);
        }
        let silicon = base.silicon.get();
        let start_up = silicon.cycles_in_us(silicon.start_up_us);
        core.set_watchdog_cycles(start_up + self.oscillator.time_out(core.get(WDTCSR)));
        core.restart_watchdog();
    }
}
