//! Revolutions of a shaft (feature `rpm`): pulses at the pin, and sensors.rpm.RPM. Most tests have
//! the feature alone, some eight outputs, too.

use std::collections::BTreeMap;

use crate::outputs::{PERIOD, SLOT, TICK};
use bench::dronecan::{Message, Rpm};
use bench::{Cycles, F_CPU_HZ};
use rig::load::{Client, Figures, Kind, Load, Loaded, Pace};
use rig::{Program, Rig, by_node_clock, corner};

const PROGRAM: Program = Program::With("rpm");

/// The highest rate of pulses that can be counted, in hertz.
const HIGHEST_HZ: f64 = 3900.0;

/// Rate of the messages, in hertz.
const RATE: i64 = 20;

/// A node that counts.
fn counting() -> Rig {
    let mut rig = PROGRAM.running();
    rig.set("RPM_RATE", RATE);
    rig
}

/// A node that counts, with eight outputs in use.
fn counting_with_outputs() -> Rig {
    Program::With("outputs,rpm").running_set(&[("OUT_COUNT", 8), ("RPM_RATE", RATE)])
}

/// Turns the shaft at a whole number of pulses a minute.
fn turn(rig: &mut Rig, pulses_a_minute: f64) {
    rig.board().set_shaft_rpm(pulses_a_minute as u32);
}

fn speed_of(message: Message) -> Option<Rpm> {
    match message {
        Message::Rpm(rpm) => Some(rpm),
        _ => None,
    }
}

/// The messages of the next `ms` milliseconds, with their times.
fn heard(rig: &mut Rig, ms: u64) -> Vec<(Cycles, Rpm)> {
    rig.forget();
    rig.run_ms(ms);
    rig.node_messages(speed_of)
}

/// The greatest error of the speeds, in percent. None is unhealthy.
#[track_caller]
fn greatest_error(heard: &[(Cycles, Rpm)], rpm: f64) -> f64 {
    assert!(!heard.is_empty());
    assert!(heard.iter().all(|(_, heard)| heard.flags == 0), "{heard:?}");
    let errors = heard
        .iter()
        .map(|(_, heard)| (f64::from(heard.rpm) / rpm * corner().clock_rate() - 1.0).abs() * 100.0);
    errors.fold(0.0, f64::max)
}

#[test]
#[ignore = "takes long: make test-all"]
fn speeds_from_60_to_234_000_are_within_a_fifth_of_a_percent() {
    let mut rig = counting();
    for rpm in [60.0, 61.0, 600.0, 6_000.0, 6_017.0, 59_957.0, 60_000.0, 60.0 * HIGHEST_HZ] {
        turn(&mut rig, rpm);
        // Two turns at the new speed, and a window.
        rig.run_ms(100 + (120_000.0 / rpm) as u64);
        let error = greatest_error(&heard(&mut rig, 2000), rpm);
        println!("{rpm} rpm: {error:.4} %");
        assert!(error < 0.2, "{rpm} rpm: {error} %");
    }
}

#[test]
fn pulses_of_a_turn_divide_the_speed() {
    let mut rig = counting();
    rig.set_all(&[("RPM_PULSES", 7), ("RPM_ID", 200)]);
    turn(&mut rig, 7.0 * 25_000.0);
    rig.run_ms(150);
    let heard = heard(&mut rig, 1000);
    let error = greatest_error(&heard, 25_000.0);
    println!("25000 rpm with 7 pulses: {error:.4} %");
    assert!(error < 0.2, "{error} %");
    assert!((18..=21).contains(&heard.len()), "{heard:?}");
    assert!(heard.iter().all(|(_, rpm)| rpm.sensor == 200));
}

#[test]
fn a_changing_speed_is_followed_within_a_tenth_of_a_second() {
    let mut rig = counting();
    turn(&mut rig, 3_000.0);
    rig.run_ms(200);
    rig.forget();
    // Speeds up from 3,000 to 12,000 in 3 s, and slows down again.
    let speed_at = |ms: u64| 3_000.0 + 3.0 * ms.min(6000 - ms) as f64;
    let begin = rig.now();
    for ms in (0..6000).step_by(10) {
        turn(&mut rig, speed_at(ms));
        rig.run_ms(10);
    }
    let heard = rig.node_messages(speed_of);
    assert!(heard.len() > 110);
    for (at, rpm) in heard {
        let ms = (at - begin) / (F_CPU_HZ / 1000);
        let difference = (f64::from(rpm.rpm) - speed_at(ms)).abs();
        // It changes by 300 in a tenth of a second.
        assert!(difference <= 300.0, "{} instead of {} after {ms} ms", rpm.rpm, speed_at(ms));
    }
}

#[test]
fn a_shaft_that_stops_has_the_speed_0_within_two_seconds_and_turns_again() {
    let mut rig = counting();
    turn(&mut rig, 6_000.0);
    rig.run_ms(300);
    turn(&mut rig, 0.0);
    let begin = rig.now();
    for (at, rpm) in heard(&mut rig, 4000) {
        let ms = (at - begin) / (F_CPU_HZ / 1000);
        // The message is prepared a little before it is on the bus.
        let most = if ms >= 2010 { 0.0 } else { 60_000.0 / (ms as f64 - 5.0).max(9.9) };
        assert!(f64::from(rpm.rpm) <= most, "{} after {ms} ms", rpm.rpm);
    }
    turn(&mut rig, 6_000.0);
    rig.run_ms(150);
    let error = greatest_error(&heard(&mut rig, 500), 6_000.0);
    assert!(error < 0.2, "{error} %");
}

#[test]
fn noise_of_100_khz_is_told_and_the_speed_comes_back_after_it() {
    let mut rig = counting();
    turn(&mut rig, 6_000.0);
    rig.run_ms(300);
    turn(&mut rig, 6_000_000.0);
    rig.run_ms(50);
    let noisy = heard(&mut rig, 2000);
    assert!(noisy.len() >= 38);
    assert!(noisy.iter().all(|(_, rpm)| (rpm.flags, rpm.rpm) == (1, 0.0)), "{noisy:?}");
    rig.forget();
    turn(&mut rig, 6_000.0);
    rig.wait_for_line("rpm: pulses counted again", 200);
    let error = greatest_error(&heard(&mut rig, 500), 6_000.0);
    assert!(error < 0.2, "{error} %");
}

#[test]
fn by_default_no_pulse_interrupts_and_no_speed_is_sent() {
    let mut rig = PROGRAM.running();
    turn(&mut rig, 60_000.0);
    let is_enabled = |rig: &mut Rig| rig.board().avr().interrupt_pins().contains(&('D', 3));
    for _ in 0..200 {
        rig.run_ms(1);
        assert!(!is_enabled(&mut rig));
    }
    assert_eq!(heard(&mut rig, 1000), []);
    // After a pulse it is masked for up to 248 us.
    turn(&mut rig, 0.0);
    rig.set("RPM_RATE", 1);
    rig.run_ms(10);
    assert!(is_enabled(&mut rig));
}

/// A load with frames of a kind back to back. The node's frames have the priority 24.
const fn full(kind: Kind, priority: u8) -> Load {
    Load { kind, priority, pace: Pace::Full }
}

/// What happened under a load.
struct Seen {
    figures: Figures,
    /// The speeds that the node sent.
    sent: Vec<Rpm>,
    /// Greatest deviations, in cycles: of the widths of the pulses of the outputs 2 to 8 from whole
    /// ticks, and of their beginnings from each other.
    width: i64,
    rise: i64,
}

/// Runs a load while the shaft has so many pulses a minute and the outputs have pulses.
fn loaded(mut rig: Rig, load: Load, pulses_a_minute: f64, ms: u64) -> Seen {
    rig.send_commands(&[1, 2, 3, 4, 5, 6, 7, 8].map(|id| (id, 4, 900.0 + 125.0 * f32::from(id))));
    rig.run_ms(100);
    turn(&mut rig, pulses_a_minute);
    rig.run_ms(110);
    let mut loaded = Loaded::with_rig(rig, Some(load), Client::Saving);
    loaded.rig.board().take_output_pulses();
    let (mut sent, mut width, mut rises) = (BTreeMap::new(), 0, Vec::new());
    for _ in 0..ms {
        loaded.run_ms(1);
        sent.extend(loaded.rig.node_messages(speed_of));
        for (output, pulses) in (1..).zip(loaded.rig.board().take_output_pulses()) {
            for pulse in pulses {
                let rest = (pulse.width_cycles as i64 + TICK / 2).rem_euclid(TICK) - TICK / 2;
                width = width.max(rest.abs());
                rises.push((by_node_clock(pulse.start) as i64 - SLOT * output).rem_euclid(PERIOD));
            }
        }
    }
    let rise = rises.iter().max().zip(rises.iter().min()).map_or(0, |(max, min)| max - min);
    Seen { figures: loaded.finish(), sent: sent.into_values().collect(), width, rise }
}

#[track_caller]
fn assert_lossless(load: Load, seen: &Seen) {
    let (figures, meter) = (&seen.figures, &seen.figures.meter);
    println!(
        "{load:?}: {} frames, release at most {}, {} of {} places; edges within {} and {} cycles",
        meter.frames,
        meter.latency.max(),
        figures.deepest,
        figures.places,
        seen.rise,
        seen.width,
    );
    assert_eq!((meter.lost, meter.out_of_order, meter.garbled), (0, 0, 0), "{load:?}");
    assert!(!figures.stuck && meter.frames > 2000, "{load:?}");
}

/// Kinds of frames that are short, or have one receive buffer only, and all kinds.
const KINDS: [Kind; 5] =
    [Kind::Command(0), Kind::Status(0), Kind::Thesis, Kind::LongCommand, Kind::Mixed];

#[test]
fn on_a_full_bus_no_frame_is_lost_and_the_speed_is_right() {
    for load in KINDS.map(|kind| full(kind, 31)) {
        let seen = loaded(counting(), load, 60.0 * HIGHEST_HZ, 500);
        assert_lossless(load, &seen);
        assert!(seen.sent.len() >= 7, "{load:?}: {:?}", seen.sent);
        for rpm in &seen.sent {
            let expected = 60.0 * HIGHEST_HZ / corner().clock_rate();
            let error = (f64::from(rpm.rpm) / expected - 1.0).abs() * 100.0;
            assert!(rpm.flags == 0 && error < 0.2, "{load:?}: {rpm:?}");
        }
    }
}

#[test]
#[ignore = "takes long: make test-all"]
fn on_a_full_bus_with_a_noisy_input_no_frame_is_lost() {
    for load in KINDS.map(|kind| full(kind, 31)) {
        assert_lossless(load, &loaded(counting(), load, 6_000_000.0, 500));
    }
}

/// The loads of `tests/boards/outputs.rs`.
#[test]
#[ignore = "takes long: make test-all"]
fn with_eight_outputs_on_a_full_bus_no_frame_is_lost_and_each_edge_is_exact() {
    for load in [Kind::LongCommand, Kind::Status(8), Kind::Command(8)].map(|kind| full(kind, 31)) {
        for pulses_a_minute in [60.0 * HIGHEST_HZ, 6_000_000.0] {
            let seen = loaded(counting_with_outputs(), load, pulses_a_minute, 1000);
            assert_lossless(load, &seen);
            assert!(seen.figures.periods.keys().eq([&(PERIOD as u64)]), "{load:?}");
            assert!(seen.width + seen.rise <= TICK, "{load:?}");
        }
    }
}
