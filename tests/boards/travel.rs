//! The parameters of the servo: limits, trim, direction, range and rate.

use std::f32::consts::{FRAC_PI_2, PI};

use bench::avr::Pulse;
use rig::{MS, POSITION, PWM, Program, Rig, UNITLESS, has_all_features};

#[track_caller]
fn assert_follows(rig: &mut Rig, cases: &[(u8, f32, f64)]) {
    for (command_type, value, pulse_us) in cases {
        rig.send_command(1, *command_type, *value);
        let pulse = rig.settled_pulse_us();
        assert!(
            (pulse - pulse_us).abs() <= 0.5,
            "type {command_type}, value {value}: {pulse} us, not {pulse_us} us"
        );
    }
}

fn with(parameters: &[(&str, i64)]) -> Rig {
    let mut rig = Rig::running();
    rig.set_all(parameters);
    rig
}

#[test]
fn deflections_reach_the_limit_on_each_side_of_the_trim() {
    let mut rig = with(&[("OUT1_MIN", 1200), ("OUT1_TRIM", 1400), ("OUT1_MAX", 1900)]);
    assert_follows(
        &mut rig,
        &[
            (UNITLESS, -1.0, 1200.0),
            (UNITLESS, -0.5, 1300.0),
            (UNITLESS, 0.0, 1400.0),
            (UNITLESS, 0.5, 1650.0),
            (UNITLESS, 1.0, 1900.0),
            (UNITLESS, 2.0, 1900.0),
            (PWM, 1000.0, 1200.0),
            (PWM, 1333.0, 1333.0),
            (PWM, 2000.0, 1900.0),
        ],
    );
}

/// The longest pulse. Each of several outputs has 2.5 ms of the period.
fn longest_us() -> u16 {
    if has_all_features() { 2400 } else { 2500 }
}

#[test]
fn the_widest_travel_is_500_us_to_the_longest_pulse() {
    let longest = f64::from(longest_us());
    let mut rig = with(&[("OUT1_MIN", 500), ("OUT1_MAX", longest_us().into())]);
    assert_follows(
        &mut rig,
        &[
            (UNITLESS, -1.0, 500.0),
            (UNITLESS, 1.0, longest),
            (PWM, 700.0, 700.0),
            (PWM, 2300.0, 2300.0),
            (PWM, 3000.0, longest),
        ],
    );
    rig.send_servo_command(0);
    assert_eq!(rig.settled_pulse_us(), 500.0);
    rig.send_servo_command(255);
    assert_eq!(rig.settled_pulse_us(), longest);
}

#[test]
fn reversed_inverts_deflections_and_not_pulse_widths() {
    let mut rig =
        with(&[("OUT1_MIN", 1200), ("OUT1_TRIM", 1400), ("OUT1_MAX", 1900), ("OUT1_REVERSED", 1)]);
    assert_follows(
        &mut rig,
        &[
            (UNITLESS, -1.0, 1900.0),
            (UNITLESS, 0.0, 1400.0),
            (UNITLESS, 0.5, 1300.0),
            (UNITLESS, 1.0, 1200.0),
            (POSITION, 3.0, 1200.0),
            (POSITION, -3.0, 1900.0),
            (PWM, 1333.0, 1333.0),
        ],
    );
    rig.send_servo_command(255);
    assert_eq!(rig.settled_pulse_us(), 1200.0);
}

#[test]
fn a_position_in_radians_is_a_part_of_the_range() {
    for (range, full) in [(180, FRAC_PI_2), (360, PI), (60, PI / 6.0), (10, PI / 36.0)] {
        let mut rig = with(&[("OUT1_RANGE", range)]);
        let half = f64::from(full * 0.5);
        let pulse = |radians: f64| 1500.0 + 500.0 * radians / f64::from(full);
        // The float16 value has eleven significant bits.
        let sent = |radians: f64| f64::from(half::f16::from_f64(radians).to_f32());
        assert_follows(
            &mut rig,
            &[
                (POSITION, full, 2000.0),
                (POSITION, -full, 1000.0),
                (POSITION, half as f32, pulse(sent(half))),
                (POSITION, 0.0, 1500.0),
                (POSITION, 4.0 * full, 2000.0),
            ],
        );
    }
}

#[test]
fn swapped_limits_and_a_trim_outside_them_are_accepted() {
    let mut rig = with(&[("OUT1_MIN", 1800), ("OUT1_MAX", 1200)]);
    rig.send_command(1, PWM, 1000.0);
    assert_eq!(rig.settled_pulse_us(), 1200.0);
    rig.set("OUT1_TRIM", 2400);
    rig.send_command(1, UNITLESS, 0.0);
    assert_eq!(rig.settled_pulse_us(), 1800.0);
    rig.set("OUT1_MIN", 1500);
    rig.set("OUT1_MAX", 1500);
    for value in [-1.0, 0.0, 1.0] {
        rig.send_command(1, UNITLESS, value);
        assert_eq!(rig.settled_pulse_us(), 1500.0);
    }
}

#[test]
fn changed_limits_apply_to_the_next_command() {
    let mut rig = Rig::running();
    rig.send_command(1, UNITLESS, 1.0);
    assert_eq!(rig.settled_pulse_us(), 2000.0);
    rig.set("OUT1_MAX", 1700);
    rig.send_command(1, UNITLESS, 1.0);
    assert_eq!(rig.settled_pulse_us(), 1700.0);
}

#[track_caller]
fn assert_periods(pulses: &[Pulse], period_cycles: u64) {
    assert!(pulses.len() > 20);
    for pulse in pulses {
        // The timer's step is half a microsecond.
        let period = pulse.period_cycles.unwrap_or(period_cycles);
        assert!(period.abs_diff(period_cycles) <= 8, "{period} cycles, not {period_cycles}");
    }
}

#[test]
fn the_rate_takes_effect_at_the_next_start() {
    for rate in [50, 100, 200, 333] {
        let mut rig = with(&[("OUT_RATE", rate)]);
        rig.send_command(1, PWM, 1234.0);
        rig.run_ms(100);
        rig.forget();
        rig.run_ms(600);
        assert_periods(&rig.pulses, 20 * MS);
        rig.save();
        rig.restart();
        rig.send_command(1, PWM, 1234.0);
        rig.run_ms(100);
        rig.forget();
        rig.run_ms(700);
        assert_periods(&rig.pulses, 1000 * MS / rate as u64);
        assert!(rig.pulses.iter().all(|pulse| pulse.width_us() == 1234.0));
    }
}

#[test]
fn at_333_hz_the_longest_pulse_fits_in_a_period() {
    let parameters = [("OUT_RATE", 333), ("OUT1_MAX", longest_us().into())];
    let mut rig = Program::Preset.running_set(&parameters);
    for value in [1.0, -1.0, 0.3] {
        rig.send_command(1, UNITLESS, value);
        rig.run_ms(20);
        rig.forget();
        rig.run_ms(200);
        assert_periods(&rig.pulses, 1000 * MS / 333);
        rig.pulses.dedup_by_key(|pulse| pulse.width_cycles);
        assert_eq!(rig.pulses.len(), 1);
    }
}
