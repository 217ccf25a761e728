//! The watchdog's register and time-out (section 11.8). `crate::watchdog` has its oscillator.

use std::cell::Cell;

use super::Own;
use crate::engine::{Timer, Vector};
use crate::regs::{MCUSR, WDCE, WDE, WDIE, WDP, WDRF, WDTCSR};
use sim_base::Cycles;

/// > Within the next four clock cycles, write the WDE and Watchdog prescaler bits (WDP) as desired
/// > (section 11.8.2)
const CHANGE_CYCLES: Cycles = 4;

/// State beside WDTCSR.
#[derive(Debug, Default)]
pub(super) struct Watchdog {
    /// Length of the next time-out.
    cycles: Cell<Cycles>,
    /// End of the time in which WDE and WDP can change.
    change_until: Cell<Cycles>,
}

impl Own {
    /// Sets the length of the watchdog's next time-out.
    pub fn set_watchdog_cycles(&self, cycles: Cycles) {
        self.watchdog.cycles.set(cycles);
    }

    /// Restarts the watchdog's time-out, if it is on.
    pub fn restart_watchdog(&self) {
        if self.get(WDTCSR) & (WDE | WDIE) != 0 {
            self.schedule(Timer::Watchdog, self.cycle() + self.watchdog.cycles.get());
        }
    }

    /// Writes WDTCSR. `crate::watchdog` starts the time-out.
    pub(super) fn write_watchdog(&self, value: u8) {
        let before = self.get(WDTCSR);
        let now = self.cycle();
        let after = if now < self.watchdog.change_until.get() {
            // > WDE is overridden by WDRF in MCUSR. (section 11.9.2)
            value | if self.get(MCUSR) & WDRF != 0 { WDE } else { 0 }
        } else {
            if value & WDCE != 0 && value & WDE != 0 {
                self.watchdog.change_until.set(now + CHANGE_CYCLES);
            }
            before & (WDE | WDP) | value & (WDE | WDIE)
        };
        self.set(WDTCSR, after & !WDCE);
        if after & (WDE | WDIE) == 0 {
            self.unschedule(Timer::Watchdog);
        }
    }

    /// After a reset by the watchdog, it stays on, with the shortest time-out.
    pub(super) fn reset_watchdog_register(&self) {
        self.watchdog.change_until.set(0);
        if self.get(MCUSR) & WDRF != 0 {
            self.set(WDTCSR, WDE);
        }
    }

    /// Starts the time-out that follows one that ended at `at`.
    pub fn continue_watchdog(&self, at: Cycles) {
        self.schedule(Timer::Watchdog, at + self.watchdog.cycles.get());
    }

    /// Handles the end of a time-out: requests the interrupt if it is enabled. Returns true if the
    /// watchdog resets the chip.
    pub fn watchdog_expires(&self) -> bool {
        let control = self.get(WDTCSR);
        if control & WDIE != 0 {
            self.raise(Vector::Watchdog);
            return false;
        }
        control & WDE != 0
    }
}
