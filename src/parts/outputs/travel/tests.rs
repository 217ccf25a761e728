use super::*;
use crate::golden::parameters;
use crate::hardware::OUTPUTS;
use half::f16;
use std::f64::consts::PI;

/// The longest pulse that a parameter can have, in microseconds.
const LONGEST_US: i32 = if OUTPUTS == 1 { 2500 } else { 2400 };

/// OUT1_MIN, OUT1_TRIM, OUT1_MAX, OUT1_RANGE.
const TRAVELS: [[i32; 4]; 14] = [
    [1000, 1500, 2000, 90],
    [500, 1500, LONGEST_US, 180],
    [500, 500, LONGEST_US, 360],
    [500, LONGEST_US, LONGEST_US, 10],
    [1000, 1200, 2000, 60],
    [1000, 1999, 2000, 90],
    [1499, 1500, 1501, 90],
    [1500, 1500, 1500, 90],
    [1100, 1500, 1900, 120],
    [2000, 1500, 1000, 90],
    [LONGEST_US, 500, 500, 45],
    [1000, LONGEST_US, 2000, 90],
    [1000, 500, 2000, 90],
    [799, 1234, 2345, 271],
];

/// A travel and its expected values: low end, trim and high end in ticks, and half its range in
/// radians.
struct Case {
    travel: Travel,
    low: f64,
    trim: f64,
    high: f64,
    half_range: f64,
    is_reversed: bool,
}

impl Case {
    fn new([min, trim, max, range]: [i32; 4], is_reversed: bool) -> Self {
        let mut travel = Travel::NONE;
        travel.update(
            0,
            &parameters(&[
                (OutputParameter::Min.of(0), min),
                (OutputParameter::Trim.of(0), trim),
                (OutputParameter::Max.of(0), max),
                (OutputParameter::Range.of(0), range),
                (OutputParameter::Reversed.of(0), is_reversed.into()),
            ]),
        );
        let (low, high) = (min.min(max), min.max(max));
        let ticks = |us: i32| f64::from(2 * us);
        Self {
            travel,
            low: ticks(low),
            trim: ticks(trim.clamp(low, high)),
            high: ticks(high),
            half_range: f64::from(range) * PI / 360.0,
            is_reversed,
        }
    }

    fn all() -> impl Iterator<Item = Self> {
        TRAVELS
            .into_iter()
            .flat_map(|travel| [false, true].map(|is_reversed| Self::new(travel, is_reversed)))
    }

    /// The longer of the two halves.
    fn span(&self) -> f64 {
        (self.trim - self.low).max(self.high - self.trim)
    }

    /// The exact pulse for a deflection of -1 to 1, in ticks.
    fn ticks(&self, deflection: f64) -> f64 {
        let deflection = deflection.clamp(-1.0, 1.0) * if self.is_reversed { -1.0 } else { 1.0 };
        let half = if deflection < 0.0 { self.trim - self.low } else { self.high - self.trim };
        self.trim + deflection * half
    }
}

#[test]
fn only_unitless_position_and_pwm_are_followed_and_numbers_that_give_a_pulse() {
    for number in 0..=u8::MAX {
        for value in 0..=u16::MAX {
            let expected = match number {
                0 => Ok(CommandType::Unitless),
                1 => Ok(CommandType::Position),
                4 if float16::is_finite(value) && float16::to_fixed(value, 1) <= 0 => {
                    Err(Line::RefusedValue)
                }
                4 => Ok(CommandType::Pwm),
                _ => Err(Line::RefusedType),
            };
            let expected = match expected {
                Ok(_) if !float16::is_finite(value) => Err(Line::RefusedValue),
                expected => expected,
            };
            assert_eq!(
                CommandType::checked(number, (value >> 8) as u8),
                expected,
                "{number} {value:04X}"
            );
        }
    }
}

#[test]
fn every_unitless_command_is_within_half_a_tick_of_exact() {
    for case in Case::all() {
        for value in i16::MIN..=i16::MAX {
            let pulse = case.travel.pulse(CommandType::Unitless, value);
            let exact = case.ticks(f64::from(value) / 16_384.0);
            assert!(
                (f64::from(pulse) - exact).abs() <= 0.5,
                "{value}: {pulse} is not {exact} {:?}",
                case.travel
            );
        }
    }
}

#[test]
fn every_position_is_within_half_a_tick_of_exact_but_for_the_rounding_in_between() {
    for case in Case::all() {
        // Half a 4096th of a radian, which is the rounding of the half range.
        let tolerance = 0.5 + case.span() / case.half_range / 8192.0;
        for value in i16::MIN..=i16::MAX {
            let pulse = case.travel.pulse(CommandType::Position, value);
            let exact = case.ticks(f64::from(value) / 4096.0 / case.half_range);
            assert!(
                (f64::from(pulse) - exact).abs() <= tolerance,
                "{value}: {pulse} is not {exact} {:?}",
                case.travel
            );
        }
    }
}

#[test]
fn every_width_is_taken_as_it_is_within_the_travel_and_never_turned_around() {
    for case in Case::all() {
        for value in 1..=i16::MAX {
            let pulse = f64::from(case.travel.pulse(CommandType::Pwm, value));
            assert_eq!(
                pulse,
                f64::from(value).clamp(case.low, case.high),
                "{value} {:?}",
                case.travel
            );
        }
    }
}

#[test]
fn more_deflection_never_gives_less_travel() {
    for case in Case::all() {
        for command in [CommandType::Unitless, CommandType::Position] {
            let mut last = case.travel.pulse(command, i16::MIN);
            for value in i16::MIN..=i16::MAX {
                let pulse = case.travel.pulse(command, value);
                assert!(
                    if case.is_reversed { pulse <= last } else { pulse >= last },
                    "{command:?} {value}"
                );
                last = pulse;
            }
        }
    }
}

#[test]
fn the_byte_of_the_thesis_covers_the_travel_exactly() {
    for case in Case::all() {
        for position in 0..=255u8 {
            let part = f64::from(if case.is_reversed { 255 - position } else { position }) / 255.0;
            let exact = case.low + part * (case.high - case.low);
            let pulse = f64::from(case.travel.pulse_of_byte(position));
            let tolerance = 0.5 + 1.0 / 16.0;
            assert!(
                (pulse - exact).abs() <= tolerance,
                "{position}: {pulse} is not {exact} {:?}",
                case.travel
            );
        }
        let ends = [0, 255].map(|position| f64::from(case.travel.pulse_of_byte(position)));
        assert_eq!(
            ends,
            if case.is_reversed { [case.high, case.low] } else { [case.low, case.high] }
        );
    }
}

#[test]
fn the_reported_position_matches_the_pulse() {
    for case in Case::all() {
        for pulse in case.low as Ticks..=case.high as Ticks {
            let bits = case.travel.position(pulse);
            assert!(float16::is_finite(bits));
            let ticks = f64::from(pulse) - case.trim;
            let half = if ticks < 0.0 { case.trim - case.low } else { case.high - case.trim };
            let mut exact = if half == 0.0 { 0.0 } else { ticks / half * case.half_range };
            if case.is_reversed {
                exact = -exact;
            }
            let reported = f16::from_bits(bits).to_f64();
            // Roundings of the half range and of the position to 4096ths of a radian, and the
            // resolution of a float16.
            let tolerance = 1.0 / 4096.0 + exact.abs() / 2048.0;
            assert!(
                (reported - exact).abs() <= tolerance,
                "{pulse}: {reported} is not {exact} {:?}",
                case.travel
            );
        }
    }
}

#[test]
fn any_pulse_has_some_position_even_outside_of_a_travel_that_was_just_made_shorter() {
    for case in Case::all() {
        for pulse in 0..=u16::MAX {
            assert!(float16::is_finite(case.travel.position(pulse)), "{pulse} {:?}", case.travel);
        }
    }
}

#[test]
fn scaled_is_rounded_and_limited_and_takes_any_numbers() {
    let numbers = [0, 1, 2, 3, 127, 128, 255, 256, 1000, 32_767, 32_768, 65_535];
    for value in numbers {
        for factor in numbers {
            assert_eq!(scaled(value, factor, 0), 0);
            for divisor in numbers.iter().filter(|&&number| number != 0 && number < 32_768) {
                let exact = f64::from(value) * f64::from(factor) / f64::from(*divisor);
                let expected = exact.min(65_535.0);
                assert!(
                    (f64::from(scaled(value, factor, *divisor)) - expected).abs() <= 0.5,
                    "{value} {factor} {divisor}"
                );
            }
        }
    }
}
