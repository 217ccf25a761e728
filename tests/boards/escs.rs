//! Motors at 400 Hz: ESC_PWM_TYPE and ESC_RATE, normal pulses of four motors and OneShot125 of
//! eight. The pulses are exact and whole, and have the newest commands.

use bench::avr::Pulse;
use bench::dronecan::Value;
use rig::flood::{Escs, Flood, Pace, Preset, Pulses, Scenario, Setup, Traffic};
use rig::load::SENDER;
use rig::{ARMED, MS, PWM, Program, Rig, US, by_node_clock, parallel};

const FOUR: Setup = Setup::of_escs(4, Escs::Fast);
const EIGHT: Setup = Setup::of_escs(8, Escs::OneShot125);

/// Cycles in a tick of the timers: half a microsecond.
const TICK: i64 = 8;
/// A period of 400 Hz.
const PERIOD_US: i64 = 2500;

/// Begin and width of each output's pulses in `ms`, in cycles, without those that have begun
/// before.
fn pulses(rig: &mut Rig, ms: u64) -> Vec<Vec<(i64, i64)>> {
    rig.run_ms(5);
    rig.take_pulses();
    let from = rig.now();
    rig.run_ms(ms);
    let plain = |pulse: &Pulse| (by_node_clock(pulse.start) as i64, pulse.width_cycles as i64);
    let all = rig.take_pulses().into_iter();
    all.map(|pulses| pulses.iter().filter(|pulse| pulse.start >= from).map(plain).collect())
        .collect()
}

/// Each output's widths in `pulses` are within a tick of these, in microseconds. `None` is no
/// pulse.
#[track_caller]
fn assert_widths(pulses: &[Vec<(i64, i64)>], expected_us: &[Option<f64>]) {
    for (output, expected) in expected_us.iter().enumerate() {
        let seen = &pulses[output];
        let is_right = match expected {
            None => seen.is_empty(),
            Some(us) => {
                let expected = (us * 16.0) as i64;
                seen.len() > 5 && seen.iter().all(|(_, width)| (width - expected).abs() <= TICK)
            }
        };
        assert!(is_right, "output {}: {expected:?}, {seen:?}", output + 1);
    }
}

#[test]
fn four_motors_have_normal_pulses_at_400_hz_whatever_the_order_of_their_widths() {
    let mut rig = FOUR.running();
    assert_widths(&pulses(&mut rig, 20), &[None; 8]);
    rig.arm(ARMED);
    let orders: [[i16; 4]; 6] = [
        [1000, 2000, 3000, 4000],
        [4000, 3000, 2000, 1000],
        [0, 8191, 0, 8191],
        [8191; 4],
        [0; 4],
        [5000, 1, 5000, 4999],
    ];
    for throttles in orders {
        rig.send_raw_command(SENDER, &throttles);
        let seen = pulses(&mut rig, 50);
        let us = |throttle: i16| Some(1000.0 + f64::from(throttle) * 1000.0 / 8192.0);
        assert_widths(&seen, &throttles.map(us));
        let mut edges: Vec<i64> = Vec::new();
        for (output, pulses) in seen[..4].iter().enumerate() {
            assert!((18..=21).contains(&pulses.len()), "{} pulses", pulses.len());
            for pair in pulses.windows(2) {
                let period = pair[1].0 - pair[0].0;
                assert!((period - PERIOD_US * 16).abs() <= TICK, "output {output}: {period}");
            }
            if output > 0 {
                edges.extend(pulses.iter().flat_map(|(at, width)| [*at, at + width]));
            }
        }
        edges.sort_unstable();
        let nearest = edges.windows(2).map(|pair| pair[1] - pair[0]).min().expect("edges");
        assert!(nearest >= 100 * US as i64, "{throttles:?}: edges {nearest} cycles apart");
    }
}

#[test]
fn eight_motors_have_oneshot125_at_400_hz_one_after_the_other() {
    let mut rig = EIGHT.running();
    rig.arm(ARMED);
    let throttles = [0, 8191, 1024, 2048, 3072, 4096, 8191, 7168];
    rig.send_raw_command(SENDER, &throttles);
    let seen = pulses(&mut rig, 50);
    assert_widths(
        &seen,
        &throttles.map(|throttle| Some(125.0 + f64::from(throttle) * 125.0 / 8192.0)),
    );
    for (output, pulses) in seen.iter().enumerate() {
        assert!((18..=21).contains(&pulses.len()), "output {output}: {} pulses", pulses.len());
    }
    // Each pulse begins within two microseconds of the end of the one before it.
    for (before, after) in seen[1..].iter().zip(&seen[2..]) {
        let begins = |end: i64| after.iter().any(|(at, _)| (0..=2 * 16).contains(&(at - end)));
        let ends = before.iter().map(|(at, width)| at + width);
        assert!(ends.clone().filter(|end| begins(*end)).count() + 1 >= before.len());
    }
}

/// An ESC takes another width for another protocol.
#[test]
fn oneshot125_is_never_outside_of_125_to_250_us_whatever_the_travel() {
    let mut rig = EIGHT.running();
    for output in 1..=8 {
        rig.set(&format!("OUT{output}_MIN"), 500);
        rig.set(&format!("OUT{output}_MAX"), 2400);
    }
    rig.arm(ARMED);
    rig.send_raw_command(SENDER, &[0, 8191, 0, 8191, 4096, 0, 8191, 8191]);
    let us = [125.0, 250.0, 125.0, 250.0, 181.5, 125.0, 250.0, 250.0].map(Some);
    assert_widths(&pulses(&mut rig, 50), &us);
}

#[test]
fn a_fast_motor_without_a_command_has_no_pulse_and_one_that_stops_its_lowest() {
    for (setup, low, half) in [(FOUR, 1000.0, 1500.0), (EIGHT, 125.0, 187.5)] {
        let mut rig = setup.running();
        rig.arm(ARMED);
        rig.send_raw_command(SENDER, &[4096]);
        assert_widths(&pulses(&mut rig, 30), &[Some(half), None, None, None]);
        rig.send_raw_command(SENDER, &[4096; 3]);
        assert_widths(&pulses(&mut rig, 30), &[Some(half), Some(half), Some(half), None]);
        // MOT_TIMEOUT.
        rig.run_ms(300);
        assert_widths(&pulses(&mut rig, 30), &[Some(low), Some(low), Some(low), None]);
        rig.send_raw_command(SENDER, &[4096; 4]);
        assert_widths(&pulses(&mut rig, 30), &[Some(half); 4]);
        rig.arm(0);
        assert_widths(&pulses(&mut rig, 30), &[Some(low); 4]);
    }
}

/// The pulses of each output are whole until the node restarts, at any phase of the period.
#[test]
fn a_restart_cuts_no_fast_pulse() {
    /// The end of the last pulse may come 2 us late, because no interrupt makes it.
    const LATE: i64 = 32;
    // The restart stops the motors, so the last pulses may be the lowest ones.
    for (setup, us, low) in [
        (FOUR, [1250.0, 2000.0, 1500.0, 1000.0], 1000.0),
        (EIGHT, [156.25, 250.0, 187.5, 125.0], 125.0),
    ] {
        let mut rig = setup.running();
        for step in 0..12 {
            rig.arm(ARMED);
            rig.send_raw_command(SENDER, &[2048, 8191, 4096, 0]);
            rig.run_ms(10);
            let until = rig.now() + step * 211 * US;
            rig.run_until(until);
            rig.take_pulses();
            let from = rig.now();
            rig.restart();
            let all = rig.take_pulses();
            for (output, expected) in us.iter().enumerate() {
                for pulse in all[output].iter().filter(|pulse| pulse.start >= from) {
                    let off = |us: &f64| (pulse.width_cycles as i64 - (us * 16.0) as i64).abs();
                    let is_whole = [*expected, low].iter().any(|us| off(us) <= LATE);
                    assert!(is_whole, "step {step}, output {output}: {pulse:?}");
                }
            }
        }
    }
}

/// What does not go together is refused, in whatever order it is set, and the log says what to set.
#[test]
fn rates_and_types_that_do_not_go_together_are_refused() {
    let mut rig = Program::Full.running();
    let refused = |rig: &mut Rig, name: &str, value: i64, before: i64, line: &str| {
        rig.run_ms(50);
        rig.serial.clear();
        let answer = rig.request_value(name, Value::Integer(value));
        assert_eq!(answer, Value::Integer(before), "{name}");
        rig.wait_for_line(&format!("{line} {name}"), 100);
    };
    const SERVO: &str = "ESC_RATE and ESC_PWM_TYPE need OUTn_TYPE 1,";
    const NO_ROOM: &str = "OUT_COUNT pulses do not fit at OUT_RATE,";
    refused(&mut rig, "ESC_RATE", 400, 50, SERVO);
    refused(&mut rig, "ESC_PWM_TYPE", 3, 1, SERVO);
    rig.set("OUT_COUNT", 5);
    for output in 1..=5 {
        refused(&mut rig, "ESC_RATE", 400, 50, SERVO);
        rig.set(&format!("OUT{output}_TYPE"), 1);
    }
    // Five have room for normal pulses at 80 Hz.
    rig.set("ESC_RATE", 80);
    refused(&mut rig, "ESC_RATE", 400, 80, NO_ROOM);
    rig.set("ESC_PWM_TYPE", 3);
    rig.set("ESC_RATE", 400);
    refused(&mut rig, "ESC_PWM_TYPE", 1, 3, NO_ROOM);
    refused(&mut rig, "OUT5_TYPE", 0, 1, SERVO);
    refused(&mut rig, "OUT_COUNT", 6, 5, SERVO);
    rig.set("OUT_COUNT", 4);
    rig.set("ESC_PWM_TYPE", 2);
    rig.set("OUT5_TYPE", 0);
    refused(&mut rig, "ESC_RATE", 401, 400, "out of range for");
}

#[test]
fn rate_and_type_do_not_change_while_armed() {
    let mut rig = FOUR.running();
    rig.arm(ARMED);
    for (name, value, before) in [("ESC_RATE", 50, 400), ("ESC_PWM_TYPE", 3, 1)] {
        let answer = rig.request_value(name, Value::Integer(value));
        assert_eq!(answer, Value::Integer(before), "{name}");
    }
    rig.arm(0);
    rig.set("ESC_RATE", 50);
}

/// A servo that is alone, or among motors, has OUT_RATE.
#[test]
fn motors_beside_servos_have_the_rate_of_the_servos() {
    let mut rig = Setup::of(Preset::Full, 2, 2).running();
    rig.arm(ARMED);
    rig.send_raw_command(SENDER, &[4096, 4096]);
    rig.send_commands(&[(1, PWM, 1500.0), (2, PWM, 1500.0)]);
    let seen = pulses(&mut rig, 205);
    for pulses in &seen[..4] {
        assert!(
            pulses.windows(2).all(|pair| (pair[1].0 - pair[0].0 - 20 * MS as i64).abs() <= TICK)
        );
        assert!((9..=11).contains(&pulses.len()), "{pulses:?}");
    }
}

/// What a pulse may have: a command that is so old, or of the interval of the commands and a
/// millisecond.
#[derive(Clone, Copy)]
enum Limit {
    Us(u64),
    Interval,
}

/// Runs floods of commands with values that no other command nearby has, for `ms` each. Fails if a
/// pulse has an older command at its beginning than the limit, if a pulse has the width of no
/// command, if pulses are missing, or if a frame is lost.
#[track_caller]
fn assert_fresh(floods: &[(Setup, Traffic, Pace, Limit)], ms: u64) {
    let wrong = parallel::each(floods, |&(setup, traffic, pace, limit)| {
        let mut flood = Flood::new(Scenario { pace, ..Scenario::full(setup, traffic) });
        flood.run_ms(ms);
        let us = |of: fn(&Pulses) -> u32| {
            let longest = flood.outcome.pulses.iter().map(of).max().expect("an output");
            u64::from(longest) / US
        };
        let (oldest_us, median_us) =
            (us(|pulses| pulses.age.max()), us(|pulses| pulses.age.median()));
        let limit_us = match limit {
            Limit::Us(us) => us,
            Limit::Interval => us(|pulses| pulses.intervals.max()) + 1000,
        };
        let outcome = flood.finish();
        let lost = outcome.meter.lost;
        let least = ms * if setup.escs == Escs::Slow { 50 } else { 400 } / 1000 * 8 / 10;
        let seen = outcome.pulses.iter().map(|pulses| pulses.seen).min().expect("an output");
        let unasked: u64 = outcome.pulses.iter().map(|pulses| pulses.unasked).sum();
        let text = format!(
            "{setup}, {traffic:?}, {pace:?}: oldest {oldest_us} of {limit_us} us, median \
             {median_us} us; {lost} of {} frames lost, {seen} pulses, {unasked} of no command, \
             {:.0} % of the bus",
            outcome.frames(),
            outcome.busy_percent
        );
        println!("{text}");
        (oldest_us > limit_us || lost > 0 || seen < least || unasked > 0).then_some(text)
    });
    let wrong: Vec<String> = wrong.into_iter().flatten().collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
#[ignore = "takes long: make test-all"]
fn at_50_hz_a_pulse_has_a_command_of_the_last_4_ms_of_a_full_bus() {
    let (servos, motors) = (Setup::of(Preset::Full, 8, 0), Setup::of(Preset::Full, 0, 8));
    let floods = [
        (servos, Traffic::List(8)),
        (servos, Traffic::List(15)),
        (motors, Traffic::Throttles(8)),
        (motors, Traffic::Throttles(20)),
        (Setup { escs: Escs::Slow, ..FOUR }, Traffic::Throttles(4)),
    ]
    .map(|(setup, traffic)| (setup, traffic, Pace::Full, Limit::Us(4000)));
    assert_fresh(&floods, 1500);
}

#[test]
#[ignore = "takes long: make test-all"]
fn at_10_percent_of_the_bus_a_pulse_has_the_last_command_but_for_a_millisecond() {
    let of = |setup, traffic| (setup, traffic, Pace::Percent(10), Limit::Interval);
    let floods = [
        of(Setup::of(Preset::Full, 8, 0), Traffic::List(8)),
        of(Setup::of(Preset::Full, 0, 8), Traffic::Throttles(8)),
        of(FOUR, Traffic::Throttles(4)),
        of(EIGHT, Traffic::Throttles(8)),
    ];
    assert_fresh(&floods, 1500);
}

#[test]
#[ignore = "takes long: make test-all"]
fn at_400_hz_a_pulse_has_a_command_of_the_last_3500_us_of_four_motors_at_any_load() {
    let floods = [25, 50, 75, 90, 100].map(|percent| {
        let pace = if percent == 100 { Pace::Full } else { Pace::Percent(percent) };
        (FOUR, Traffic::Throttles(4), pace, Limit::Us(3500))
    });
    assert_fresh(&floods, 1000);
}

#[test]
fn at_400_hz_a_pulse_has_a_command_of_the_last_3500_us_of_eight_motors_up_to_75_percent() {
    let floods = [25, 50, 75]
        .map(|percent| (EIGHT, Traffic::Throttles(8), Pace::Percent(percent), Limit::Us(3500)));
    assert_fresh(&floods, 1000);
}

/// An autopilot has its own clock: here it is slower by a command in a second, so that each phase
/// of a command and a pulse occurs.
#[test]
#[ignore = "takes long: make test-all"]
fn at_400_commands_a_second_a_pulse_has_the_last_command_but_for_a_millisecond() {
    let floods = [(FOUR, 4), (EIGHT, 8)]
        .map(|(setup, motors)| (setup, Traffic::Throttles(motors), Pace::Hz(399), Limit::Interval));
    assert_fresh(&floods, 5000);
}

/// At half of a full bus no frame is lost at 400 Hz, whatever the transfers are, and each pulse of
/// OneShot125 is inside its range.
#[test]
fn at_400_hz_no_frame_is_lost_up_to_50_percent_of_the_bus() {
    let floods: Vec<(Setup, Traffic)> = [FOUR, EIGHT]
        .into_iter()
        .flat_map(|setup| Traffic::all(setup).into_iter().map(move |traffic| (setup, traffic)))
        .collect();
    let wrong = parallel::each(&floods, |&(setup, traffic)| {
        let pace = Pace::Percent(50);
        let mut flood = Flood::new(Scenario { pace, ..Scenario::full(setup, traffic) });
        flood.run_ms(400);
        let outcome = flood.finish();
        let widths = || outcome.pulses.iter().flat_map(|pulses| pulses.widths.values());
        let (least, most) = (widths().min().unwrap_or(&2000), widths().max().unwrap_or(&2000));
        let is_outside = setup == EIGHT && (*least < 125 * 16 - 8 || *most > 250 * 16 + 8);
        let lost = outcome.meter.lost;
        (lost > 0 || is_outside).then(|| {
            format!("{setup}, {traffic:?}: {lost} of {} lost, {least} to {most}", outcome.frames())
        })
    });
    let wrong: Vec<String> = wrong.into_iter().flatten().collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
