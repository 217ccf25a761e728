//! Keeps simulated time at a chosen multiple of real time, and measures the speed.
//!
//! Real time is an argument, so that tests can set it. If the simulation is too slow, the pace
//! drops the lag above a limit. So the simulation does not run at full speed after a stall.

use bench::{Cycles, F_CPU_HZ};
use std::str::FromStr;
use std::time::Duration;

/// Shortest real time over which the speed is measured, in seconds.
const MEASURE_S: f64 = 1.0;

/// Simulated seconds for each real second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Speed {
    Factor(f64),
    /// As fast as the host can.
    Max,
}

impl FromStr for Speed {
    type Err = String;

    fn from_str(text: &str) -> Result<Speed, String> {
        if text == "max" {
            return Ok(Speed::Max);
        }
        match text.parse::<f64>() {
            Ok(factor @ 0.001..=1000.0) => Ok(Speed::Factor(factor)),
            _ => Err(String::from("use a factor from 0.001 to 1000, such as 1 or 0.1, or max")),
        }
    }
}

/// Measured speed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// Simulated time divided by real time.
    pub factor: f64,
    /// Simulated time divided by the real time that the simulator worked, without its waits: the
    /// factor of `--speed max`.
    pub capacity: f64,
}

/// The pace of a run. All real times are measured from the start of the run.
pub struct Pace {
    speed: Speed,
    /// Largest lag for which the simulation compensates, in seconds of real time.
    lag_max_s: f64,
    /// A real time in seconds, and the simulated time that is due then.
    anchor: (f64, Cycles),
    current: Interval,
    last: Measured,
    /// The whole run without its pauses.
    whole: Interval,
}

/// A time interval over which the speed is measured.
#[derive(Clone, Copy, Default)]
struct Interval {
    real_start_s: f64,
    simulated: Cycles,
    worked_s: f64,
}

impl Interval {
    fn measured(&self, real_s: f64) -> Measured {
        let simulated_s = self.simulated as f64 / F_CPU_HZ as f64;
        let over = |time_s: f64| {
            if time_s > 0.0 { simulated_s / time_s } else { 0.0 }
        };
        Measured { factor: over(real_s - self.real_start_s), capacity: over(self.worked_s) }
    }
}

impl Pace {
    /// A pace that starts at 0 in real and simulated time, and compensates for a lag of at most
    /// `lag_max`.
    pub fn new(speed: Speed, lag_max: Duration) -> Pace {
        Pace {
            speed,
            lag_max_s: lag_max.as_secs_f64(),
            anchor: (0.0, 0),
            current: Interval::default(),
            last: Measured::default(),
            whole: Interval::default(),
        }
    }

    /// Adds a slice of `simulated` cycles, which took `worked` of real time and ended at `real`.
    pub fn add_slice(&mut self, simulated: Cycles, worked: Duration, real: Duration) {
        let real_s = real.as_secs_f64();
        for interval in [&mut self.current, &mut self.whole] {
            interval.simulated += simulated;
            interval.worked_s += worked.as_secs_f64();
        }
        if real_s - self.current.real_start_s >= MEASURE_S {
            self.last = self.current.measured(real_s);
            self.current = Interval { real_start_s: real_s, ..Interval::default() };
        }
    }

    /// Real time to wait, from `real` on, before the simulation may go beyond the simulated time
    /// `now`.
    pub fn wait(&mut self, now: Cycles, real: Duration) -> Duration {
        let Speed::Factor(factor) = self.speed else {
            return Duration::ZERO;
        };
        let real_s = real.as_secs_f64();
        let due_s = self.anchor.0 + (now - self.anchor.1) as f64 / F_CPU_HZ as f64 / factor;
        if real_s - due_s > self.lag_max_s {
            self.anchor = (real_s, now);
        }
        Duration::from_secs_f64((due_s - real_s).max(0.0))
    }

    /// Lets the slice of `simulated` cycles that has just passed take `times` as long.
    pub fn stretch(&mut self, simulated: Cycles, times: u32) {
        if let Speed::Factor(factor) = self.speed {
            let slice_s = simulated as f64 / F_CPU_HZ as f64 / factor;
            self.anchor.0 += slice_s * f64::from(times - 1);
        }
    }

    /// Continues at `real` after a pause of `paused`, which changes neither the pace nor the
    /// measured speed.
    pub fn resume(&mut self, now: Cycles, paused: Duration, real: Duration) {
        self.anchor = (real.as_secs_f64(), now);
        self.current.real_start_s += paused.as_secs_f64();
        self.whole.real_start_s += paused.as_secs_f64();
    }

    /// The speed of the whole run up to `real`.
    pub fn average(&self, real: Duration) -> Measured {
        self.whole.measured(real.as_secs_f64())
    }

    /// The speed of the last complete interval; before that the speed since the start.
    pub fn measured(&self, real: Duration) -> Measured {
        if self.last == Measured::default() {
            self.current.measured(real.as_secs_f64())
        } else {
            self.last
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn at(speed: Speed) -> Pace {
        Pace::new(speed, 250 * MS)
    }

    #[test]
    fn speeds_are_factors_or_max() {
        assert_eq!("max".parse(), Ok(Speed::Max));
        assert_eq!("0.1".parse(), Ok(Speed::Factor(0.1)));
        for wrong in ["0", "-1", "inf", "NaN", "fast", ""] {
            assert!(wrong.parse::<Speed>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn real_time_waits_for_the_rest_of_the_slice() {
        let mut pace = at(Speed::Factor(1.0));
        let wait = pace.wait(F_CPU_HZ / 100, 4 * MS);
        assert_eq!(wait.as_micros(), 6_000);
        let mut slow = at(Speed::Factor(0.1));
        assert_eq!(slow.wait(F_CPU_HZ / 100, 4 * MS).as_micros(), 96_000);
        let mut fast = at(Speed::Max);
        assert!(fast.wait(F_CPU_HZ, MS).is_zero());
    }

    /// After a long stall the simulation must not run at full speed.
    #[test]
    fn the_pace_compensates_for_a_short_lag_and_drops_a_long_one() {
        let mut pace = at(Speed::Factor(1.0));
        assert!(pace.wait(0, 200 * MS).is_zero());
        assert!(pace.wait(F_CPU_HZ / 10, 200 * MS).is_zero());
        assert!(pace.wait(F_CPU_HZ / 10, 5_000 * MS).is_zero());
        let wait = pace.wait(F_CPU_HZ / 5, 5_000 * MS);
        assert_eq!(wait.as_millis(), 100);
    }

    #[test]
    fn a_stretched_slice_takes_longer_and_the_next_one_does_not() {
        let mut pace = at(Speed::Factor(1.0));
        pace.stretch(F_CPU_HZ / 1000, 10);
        assert_eq!(pace.wait(F_CPU_HZ / 1000, MS).as_millis(), 9);
        assert_eq!(pace.wait(F_CPU_HZ / 500, 10 * MS).as_millis(), 1);
    }

    #[test]
    fn the_factor_and_the_capacity_are_measured() {
        let mut pace = at(Speed::Factor(1.0));
        for slice in 1..=100 {
            pace.add_slice(F_CPU_HZ / 100, 2 * MS, slice * 10 * MS);
        }
        let measured = pace.measured(1_000 * MS);
        assert!((measured.factor - 1.0).abs() < 1e-6);
        assert!((measured.capacity - 5.0).abs() < 1e-6);
    }

    #[test]
    fn a_pause_changes_neither_the_pace_nor_the_factor() {
        let mut pace = at(Speed::Factor(1.0));
        pace.add_slice(F_CPU_HZ / 2, MS, 500 * MS);
        pace.resume(F_CPU_HZ / 2, 9_500 * MS, 10_000 * MS);
        assert_eq!(pace.wait(F_CPU_HZ, 10_000 * MS).as_millis(), 500);
        pace.add_slice(F_CPU_HZ / 2, MS, 10_500 * MS);
        assert!((pace.average(10_500 * MS).factor - 1.0).abs() < 1e-6);
        assert!((pace.measured(10_500 * MS).factor - 1.0).abs() < 1e-6);
    }
}
