//! The watchdog's oscillator, and the flag WDIF (datasheet section 11.8).
//!
//! simavr's watchdog counts exactly 125 CPU cycles for each cycle of its oscillator. The chip has
//! an RC oscillator of "128 kHz", which is independent of the crystal. In this model the frequency
//! differs from chip to chip by up to 10 %, and each time-out has jitter. Both follow from the
//! chip's seed, so that a run can be repeated, and chips with different seeds differ. The datasheet
//! has no value for the jitter. The model's 0.01 % of a time-out of 16 ms is less than the jitter
//! that published random number generators use.
//!
//! In simavr a program cannot clear WDIF by writing a one to it. In this model it can.

use std::cell::RefCell;

use super::base::{Base, Peripheral};
use super::chip::Chip;
use super::core::{Core, Vector};
use super::regs::{WDE, WDIE, WDIF, WDP, WDTCSR};
use sim_base::Cycles;
use sim_base::Noise;

/// > 2K (2048) cycles (table 11-2), of 125 CPU cycles each.
const SHORTEST_TIME_OUT: Cycles = 2048 * 125;
/// Largest deviation of a chip's frequency.
const TOLERANCE_PER_MILLION: u64 = 100_000;
/// Largest deviation of the shortest time-out from its mean. It grows with the square root of the
/// time, like a random walk.
const JITTER_CYCLES: u64 = 25;

/// The oscillator of one chip.
#[derive(Debug)]
pub(super) struct Watchdog {
    noise: Noise,
    per_million: u64,
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
        self.borrow_mut().reset(&base.core);
    }
}

impl Watchdog {
    /// The oscillator of a chip with this seed.
    pub fn new(seed: u64) -> Watchdog {
        let mut noise = Noise::new(seed);
        let per_million =
            1_000_000 - TOLERANCE_PER_MILLION + noise.below(2 * TOLERANCE_PER_MILLION + 1);
        Watchdog { noise, per_million }
    }

    /// Length of the next time-out in CPU cycles, with `control` in WDTCSR.
    fn time_out(&mut self, control: u8) -> Cycles {
        let prescaler = control & 0b111 | (control & 1 << 5) >> 2;
        let jitter = JITTER_CYCLES << (prescaler / 2);
        let mean = (SHORTEST_TIME_OUT << prescaler) * self.per_million / 1_000_000;
        mean - jitter + self.noise.below(2 * jitter + 1)
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
        core.set_watchdog_cycles(self.time_out(after));
        // If the length of the time-out changes, simavr keeps the end of the running one. This
        // model restarts it, as for programs that execute WDR before the change, which the
        // datasheet demands.
        if enabled && (before & (WDE | WDIE) == 0 || (before ^ after) & WDP != 0) {
            core.restart_watchdog();
        }
    }

    /// Handles the end of a time-out: sets the length of the next one.
    pub fn timed_out(&mut self, core: &Core) {
        core.set_watchdog_cycles(self.time_out(core.get(WDTCSR)));
    }

    /// Handles a reset of the chip. After a reset by the watchdog, the watchdog keeps running.
    fn reset(&mut self, core: &Core) {
        self.timed_out(core);
        if core.get(WDTCSR) & WDE != 0 {
            core.restart_watchdog();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time_outs(seed: u64) -> Vec<Cycles> {
        let mut watchdog = Watchdog::new(seed);
        (0..100).map(|_| watchdog.time_out(0)).collect()
    }

    #[test]
    fn the_time_outs_of_a_chip_deviate_from_16_ms_by_at_most_10_percent_and_have_jitter() {
        for seed in 0..200 {
            let time_outs = time_outs(seed);
            let (min, max) = (time_outs.iter().min().unwrap(), time_outs.iter().max().unwrap());
            assert!(
                (230_000..=282_000).contains(min) && max - min <= 2 * JITTER_CYCLES,
                "{seed}: {min} to {max}"
            );
            assert!(max - min > JITTER_CYCLES, "no jitter");
        }
    }

    #[test]
    fn chips_with_different_seeds_differ_and_equal_seeds_give_equal_chips() {
        assert_eq!(time_outs(7), time_outs(7));
        assert_ne!(time_outs(7), time_outs(8));
    }

    #[test]
    fn the_prescaler_doubles_the_time_out() {
        let mut watchdog = Watchdog::new(1);
        let mean = watchdog.time_out(0) as f64;
        for (control, factor) in
            [(0b001, 2.0), (0b100, 16.0), (0b10_0000, 256.0), (0b10_0001, 512.0)]
        {
            let time_out = watchdog.time_out(control | WDE) as f64;
            assert!((time_out / mean / factor - 1.0).abs() < 0.001, "{control:#b}");
        }
    }
}
