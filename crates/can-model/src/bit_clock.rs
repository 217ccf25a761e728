//! The grid of bit boundaries of a bus, in whole AVR cycles.
//!
//! Boundary n is at n x F_CPU / bit rate, rounded down. It does not drift, even at rates that do
//! not divide 16 MHz.

use sim_base::{Cycles, F_CPU_HZ};

/// Picoseconds of an AVR cycle.
pub(super) const PS_PER_CYCLE: u64 = 1_000_000_000_000 / F_CPU_HZ;

/// The start of the current bit and of later ones.
#[derive(Clone, Copy, Debug)]
pub(super) struct BitClock {
    bit_rate: u64,
    start: Cycles,
    /// The fraction that rounding down removed from `start`, in 1 / bit rate cycles.
    rest: u64,
    /// Cycles of a bit, if that is an integer.
    whole: Option<u64>,
}

impl BitClock {
    pub fn new(bit_rate: u32) -> BitClock {
        let bit_rate = u64::from(bit_rate);
        assert!(bit_rate > 0 && bit_rate <= F_CPU_HZ, "no bus runs at {bit_rate} bit/s here");
        let whole = F_CPU_HZ.is_multiple_of(bit_rate).then_some(F_CPU_HZ / bit_rate);
        BitClock { bit_rate, start: 0, rest: 0, whole }
    }

    /// Start of the current bit.
    pub fn start(&self) -> Cycles {
        self.start
    }

    /// Start of the bit `bits` after the current one.
    pub fn after(&self, bits: u64) -> Cycles {
        match self.whole {
            Some(whole) => self.start + bits * whole,
            None => self.start + (self.rest + bits * F_CPU_HZ) / self.bit_rate,
        }
    }

    /// Number of bits, with the current one, that have ended at `at`.
    pub fn bits_until(&self, at: Cycles) -> u64 {
        let Some(cycles) = at.checked_sub(self.start) else {
            return 0;
        };
        match self.whole {
            Some(whole) => cycles / whole,
            None => ((cycles + 1) * self.bit_rate - 1 - self.rest) / F_CPU_HZ,
        }
    }

    pub fn advance(&mut self, bits: u64) {
        let start = self.after(bits);
        if self.whole.is_none() {
            self.rest = (self.rest + bits * F_CPU_HZ) % self.bit_rate;
        }
        self.start = start;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boundaries_do_not_drift_at_a_rate_that_does_not_divide_the_clock() {
        let mut clock = BitClock::new(83_333);
        for _ in 0..83_333 {
            clock.advance(1);
        }
        assert_eq!(clock.start(), F_CPU_HZ);
        assert_eq!(BitClock::new(83_333).after(83_333), F_CPU_HZ);
    }

    #[test]
    fn a_bit_is_over_exactly_at_its_end() {
        for rate in [1_000_000, 500_000, 125_000, 800_000, 83_333, 999_999] {
            let mut clock = BitClock::new(rate);
            clock.advance(12_345);
            for bits in [1, 2, 1000] {
                let end = clock.after(bits);
                assert_eq!(clock.bits_until(end), bits, "{rate}");
                assert_eq!(clock.bits_until(end - 1), bits - 1, "{rate}");
            }
        }
    }
}
