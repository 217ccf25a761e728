//! The discharge of a battery (`--pwr-discharge`): how the voltage at the node's input falls.

use bench::{Cycles, F_CPU_HZ};

/// The voltage of a lithium polymer battery under load, in thousandths of that of the full one, for
/// the part of the charge that was drawn, in thousandths: 4.2 V, 3.95 V, 3.6 V, 3.3 V, 3.0 V for a
/// cell.
const CURVE: [(u64, u64); 5] = [(0, 1000), (150, 940), (800, 857), (950, 786), (1000, 714)];

/// A battery that is empty after some time.
#[derive(Clone, Copy, Debug)]
pub struct Discharge {
    /// Millivolts at the input for the full battery.
    full_mv: u32,
    empty_at: Cycles,
}

impl Discharge {
    /// A battery that is full at the start, and empty after so many minutes.
    pub fn new(full_mv: u32, minutes: f64) -> Self {
        Self { full_mv, empty_at: (minutes * 60.0 * F_CPU_HZ as f64) as Cycles }
    }

    /// Millivolts at the input.
    pub fn millivolts(&self, now: Cycles) -> u32 {
        let drawn = (now * 1000).checked_div(self.empty_at).unwrap_or(1000).min(1000);
        let end = CURVE.iter().position(|&(at, _)| at >= drawn).unwrap_or(CURVE.len() - 1).max(1);
        let [(before, high), (after, low)] = [CURVE[end - 1], CURVE[end]];
        let level = high - (high - low) * (drawn - before) / (after - before);
        (u64::from(self.full_mv) * level / 1000) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_voltage_falls_fast_slowly_and_fast_and_stays_when_the_battery_is_empty() {
        let minute = 60 * F_CPU_HZ;
        let discharge = Discharge::new(1000, 10.0);
        let after = |tenths: u64| discharge.millivolts(tenths * minute / 10);
        assert_eq!(
            [0, 5, 15, 80, 95, 99, 100, 500].map(after),
            [1000, 980, 940, 857, 786, 729, 714, 714]
        );
        let falls = (0..100).all(|tenths| after(tenths) >= after(tenths + 1));
        assert!(falls);
        assert_eq!(Discharge::new(1000, 0.0).millivolts(5), 714, "empty from the start");
    }
}
