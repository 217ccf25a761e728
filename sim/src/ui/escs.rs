//! The outputs that have a speed controller (ESC) with its motor in place of a servo, and the
//! throttle that the ESC takes from a pulse.
//!
//! An output has an ESC if `--escs` names it, if its pulses are OneShot125 (`ESC_PWM_TYPE` 3), or
//! if they come more often than `OUT_RATE` allows, which only `ESC_RATE` does.

use crate::time::micros;
use bench::{Cycles, F_CPU_HZ};

/// The pulses of no and of full throttle, in microseconds.
const NORMAL_US: [f64; 2] = [1000.0, 2000.0];
const ONESHOT125_US: [f64; 2] = [125.0, 250.0];
/// A pulse of OneShot125 is shorter: no servo takes one.
const NORMAL_FROM_US: f64 = 375.0;
/// OUT_RATE is at most 333 Hz.
const MOTORS_ABOVE_HZ: u64 = 335;

/// The outputs that `--escs` names.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Escs(Vec<u8>);

/// What an ESC takes from a pulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Throttle {
    /// 0 to 100.
    pub percent: f64,
    /// The pulse is an eighth of a normal one.
    pub is_oneshot125: bool,
}

impl Escs {
    /// These outputs, counted from 1.
    pub fn new(outputs: &[u8]) -> Escs {
        Escs(outputs.to_vec())
    }

    /// True if the output is named.
    pub fn has(&self, output: u8) -> bool {
        self.0.contains(&output)
    }

    /// The throttle for a pulse of an output, whose pulses begin `period` after each other. `None`
    /// if the output has a servo.
    pub fn throttle(&self, output: u8, width: Cycles, period: Option<Cycles>) -> Option<Throttle> {
        let us = micros(width);
        let is_oneshot125 = us < NORMAL_FROM_US;
        let is_fast = period.is_some_and(|period| period * MOTORS_ABOVE_HZ < F_CPU_HZ);
        let [none, full] = if is_oneshot125 { ONESHOT125_US } else { NORMAL_US };
        let percent = ((us - none) / (full - none) * 100.0).clamp(0.0, 100.0);
        let is_motor = is_oneshot125 || is_fast || self.has(output);
        is_motor.then_some(Throttle { percent, is_oneshot125 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const US: Cycles = F_CPU_HZ / 1_000_000;

    fn percent(escs: &Escs, us: Cycles, rate_hz: u64) -> Option<(f64, bool)> {
        let throttle = escs.throttle(2, us * US, Some(F_CPU_HZ / rate_hz));
        throttle.map(|throttle| (throttle.percent, throttle.is_oneshot125))
    }

    #[test]
    fn normal_pulses_of_a_named_output_or_at_400_hz_are_the_throttle_of_a_motor() {
        let named = Escs::new(&[2, 3]);
        for (us, expected) in [(1000, 0.0), (1250, 25.0), (2000, 100.0), (900, 0.0), (2100, 100.0)]
        {
            assert_eq!(percent(&named, us, 50), Some((expected, false)));
            assert_eq!(percent(&Escs::default(), us, 400), Some((expected, false)));
        }
        assert_eq!(named.throttle(4, 1500 * US, Some(F_CPU_HZ / 50)), None);
        for rate_hz in [50, 333] {
            assert_eq!(percent(&Escs::default(), 1500, rate_hz), None);
        }
    }

    #[test]
    fn a_pulse_of_125_to_250_us_is_the_throttle_of_a_motor() {
        for (us, expected) in [(125, 0.0), (175, 40.0), (250, 100.0)] {
            assert_eq!(percent(&Escs::default(), us, 50), Some((expected, true)));
        }
    }
}
