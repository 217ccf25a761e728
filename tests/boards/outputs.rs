//! An Uno as a hub of eight outputs. Each output follows its own commands and has its own failsafe,
//! and all pulses are exact under any load.

use std::collections::BTreeMap;

use bench::autopilot::{Moves, Profile, Settings};
use bench::avr::Pulse;
use bench::dronecan::{Message, ParameterRequest, Value};
use rig::load::{Client, Figures, Kind, Load, Loaded, Pace};
use rig::status::{ERROR, FAILSAFE, OK, TRANSFER_ERRORS};
use rig::{MS, PWM, Program, Rig, by_node_clock, node_ms};

const PROGRAM: Program = Program::Full;

const OUTPUTS: usize = 8;
/// Cycles in a tick of the timers: half a microsecond.
pub const TICK: i64 = 8;
/// Cycles from the beginning of one output's pulse to that of the next output's: 2.5 ms.
pub const SLOT: i64 = 40_000;
/// Cycles in a period of the pulses: 20 ms.
pub const PERIOD: i64 = 20 * MS as i64;

/// A hub that uses all outputs.
fn hub() -> Rig {
    PROGRAM.running_set(&[("OUT_COUNT", OUTPUTS as i64)])
}

/// A different width for each output.
fn width_us(output: usize) -> f64 {
    1000.0 + 125.0 * output as f64
}

/// Commands these outputs, counted from 0. By default output n has the ID n + 1.
fn command(rig: &mut Rig, outputs: impl IntoIterator<Item = usize>) {
    let commands: Vec<_> = outputs
        .into_iter()
        .map(|output| (output as u8 + 1, PWM, width_us(output) as f32))
        .collect();
    rig.send_commands(&commands);
}

/// Starts and widths of the pulses of each output, in cycles, since the last call.
fn pulses(rig: &mut Rig) -> Vec<Vec<(i64, i64)>> {
    let plain = |pulse: &Pulse| (by_node_clock(pulse.start) as i64, pulse.width_cycles as i64);
    rig.take_pulses().iter().map(|pulses| pulses.iter().map(plain).collect()).collect()
}

#[test]
fn each_output_follows_the_commands_for_its_id_and_gives_no_pulse_before_the_first() {
    let mut rig = hub();
    assert_eq!(rig.widths_us(), [None; OUTPUTS]);
    for output in 0..OUTPUTS {
        command(&mut rig, [output]);
        let expected: Vec<_> = (0..OUTPUTS).map(|n| (n <= output).then(|| width_us(n))).collect();
        assert_eq!(rig.widths_us(), expected, "output {output}");
    }
    rig.set("OUT7_ID", 200);
    rig.send_commands(&[(200, PWM, 1111.0), (7, PWM, 1999.0), (9, PWM, 1999.0)]);
    assert_eq!(rig.widths_us()[6], Some(1111.0));
}

#[test]
fn outputs_with_the_same_id_follow_the_same_command_each_with_its_own_travel() {
    let mut rig = hub();
    rig.set("OUT5_ID", 2);
    rig.set("OUT5_REVERSED", 1);
    rig.send_commands(&[(1, 0, 0.0), (2, 0, 0.5)]);
    let widths = rig.widths_us();
    assert_eq!(
        (widths[0], widths[1], widths[4], widths[2]),
        (Some(1500.0), Some(1750.0), Some(1250.0), None)
    );
}

#[test]
fn while_ids_change_each_output_follows_the_entries_for_its_own() {
    let mut rig = hub();
    // The IDs of outputs 1 to 4: shared, taken from one before and from one after, and their own.
    let steps: [[u8; 4]; 7] = [
        [1, 2, 2, 2],
        [1, 9, 2, 2],
        [2, 9, 2, 2],
        [2, 2, 2, 18],
        [1, 2, 3, 4],
        [4, 3, 2, 1],
        [17, 17, 1, 1],
    ];
    let mut before = [1, 2, 3, 4];
    for ids in steps {
        for output in 0..4 {
            if ids[output] != before[output] {
                rig.set(&format!("OUT{}_ID", output + 1), i64::from(ids[output]));
            }
        }
        before = ids;
        rig.run_ms(20);
        let width = |id: u8| 1000.0 + 10.0 * f32::from(id);
        let entries: Vec<_> = [1, 2, 3, 4, 9, 17, 18].map(|id| (id, PWM, width(id))).to_vec();
        rig.send_commands(&entries);
        assert_eq!(rig.widths_us()[..4], ids.map(|id| Some(f64::from(width(id)))), "{ids:?}");
    }
}

#[test]
fn by_default_one_output_is_in_use_and_the_other_pins_are_inputs() {
    const DDRB: u16 = 0x24;
    let mut rig = PROGRAM.running();
    command(&mut rig, 0..OUTPUTS);
    let mut expected = [None; OUTPUTS];
    expected[0] = Some(width_us(0));
    assert_eq!(rig.widths_us(), expected);
    let directions = |rig: &mut Rig| [0, 3, 6].map(|port| rig.board().avr().sram(DDRB + port));
    let before = directions(&mut rig);
    let mut hub = hub();
    let [b, c, d] = directions(&mut hub);
    // Pins D8, A1 to A3, D5 to D7.
    assert_eq!([b ^ before[0], c ^ before[1], d ^ before[2]], [1 << 0, 0b1110, 0b1110_0000]);
}

/// An attempt to set OUT_COUNT or OUT_RATE too high leaves both unchanged.
#[test]
fn counts_and_rates_whose_pulses_do_not_fit_in_a_period_are_rejected_and_logged() {
    for (count, highest_rate) in [(8, 50), (6, 66), (4, 100), (3, 133), (2, 200), (1, 333)] {
        let mut rig = PROGRAM.running();
        rig.set_all(&[("OUT_COUNT", count), ("OUT_RATE", highest_rate)]);
        if highest_rate < 333 {
            assert_eq!(
                rig.request_value("OUT_RATE", Value::Integer(highest_rate + 1)),
                Value::Integer(highest_rate)
            );
            rig.wait_for_line("OUT_COUNT pulses do not fit at OUT_RATE", 100);
            assert_eq!(
                rig.request_value("OUT_COUNT", Value::Integer(count + 1)),
                Value::Integer(count)
            );
        }
    }
}

#[test]
fn four_outputs_run_at_100_hz() {
    let mut rig = PROGRAM.running_set(&[("OUT_COUNT", 4), ("OUT_RATE", 100)]);
    command(&mut rig, 0..OUTPUTS);
    rig.run_ms(50);
    pulses(&mut rig);
    rig.run_until(rig.now() + node_ms(200));
    let seen = pulses(&mut rig);
    for (output, pulses) in seen.iter().enumerate() {
        assert_eq!(pulses.len(), if output < 4 { 20 } else { 0 }, "output {output}");
        for pair in pulses.windows(2) {
            assert!(
                (pair[1].0 - pair[0].0 - 10 * MS as i64).abs() <= TICK,
                "output {output}: {pair:?}"
            );
        }
    }
}

#[test]
fn each_pulse_has_the_width_that_was_commanded_two_milliseconds_before_it_begins_or_a_newer_one() {
    let mut rig = hub();
    let mut commanded = vec![];
    // Commands at all phases of the period, each with a width of its own.
    for step in 0..150 {
        let width_us = 1000.0 + 5.0 * step as f32;
        let all: Vec<_> = (1..=OUTPUTS as u8).map(|id| (id, PWM, width_us)).collect();
        rig.send_commands(&all);
        commanded.push((by_node_clock(rig.now()) as i64, (width_us * 16.0) as i64));
        let next = rig.now() + 25 * MS + 2_300 * step;
        rig.run_until(next);
    }
    for (output, pulses) in pulses(&mut rig).iter().enumerate() {
        assert!(pulses.len() > 150, "output {output}: {} pulses", pulses.len());
        for (start, width) in pulses {
            let known = commanded.iter().rposition(|(at, _)| at + 2 * (MS as i64) <= *start);
            let pulse = commanded.iter().rposition(|(_, of)| (of - width).abs() <= TICK);
            assert!(pulse.is_some(), "output {output}: {width} cycles are of no command");
            assert!(pulse >= known, "output {output}: {pulse:?} at {start}, after {known:?}");
        }
    }
}

#[test]
fn an_output_whose_pulses_end_has_whole_pulses_until_then() {
    let mut rig = hub();
    for output in 1..=OUTPUTS {
        rig.set(&format!("OUT{output}_FS"), 3);
        rig.set(&format!("OUT{output}_TIMEOUT"), 100);
    }
    let start = rig.now();
    // The failsafe begins at each phase of the period.
    for step in 1..=80 {
        command(&mut rig, 0..OUTPUTS);
        rig.run_until(start + step * (160 * MS + MS / 4));
        for (output, seen) in pulses(&mut rig).iter().enumerate() {
            assert!((4..=7).contains(&seen.len()), "step {step}, output {output}: {seen:?}");
            let expected = (width_us(output) * 16.0) as i64;
            let is_whole = |(_, width): &(i64, i64)| (width - expected).abs() <= TICK;
            assert!(seen.iter().all(is_whole), "step {step}, output {output}: {seen:?}");
        }
    }
}

#[test]
fn the_failsafe_of_one_output_affects_no_other_and_is_reported_with_its_number() {
    let mut rig = hub();
    rig.set_all(&[("OUT3_FS", 2), ("OUT3_FS_PWM", 1900), ("OUT6_FS", 3)]);
    for (silent, expected, bit) in [(2, Some(1900.0), 1 << 2), (5, None, 1 << 5)] {
        for round in 0..30 {
            command(&mut rig, (0..OUTPUTS).filter(|&output| output != silent || round == 0));
            rig.run_ms(50);
        }
        let widths = rig.widths_us();
        for (output, width) in widths.into_iter().enumerate() {
            assert_eq!(
                width,
                if output == silent { expected } else { Some(width_us(output)) },
                "output {output}"
            );
        }
        assert_eq!(rig.next_status(), (ERROR, FAILSAFE));
        assert!(
            rig.serial.contains(&format!("FAILSAFE of output {}", silent + 1)),
            "{}",
            rig.serial
        );
        let reported = rig.node_messages(|message| match message {
            Message::KeyValue(pair) if pair.key == b"fs" => Some(pair.value),
            _ => None,
        });
        assert!(
            !reported.is_empty() && reported.iter().all(|(_, value)| *value == bit as f32),
            "{reported:?}"
        );
        assert_eq!(rig.serial.matches("FAILSAFE of output").count(), 1, "{}", rig.serial);
        // So long that no output loses its commands, until the next second.
        for _ in 0..22 {
            command(&mut rig, 0..OUTPUTS);
            rig.run_ms(50);
        }
        assert!(rig.serial.contains("over: FAILSAFE"), "{}", rig.serial);
        assert_eq!(rig.status_now(), (OK, 0));
        // The outputs are reported once they have not changed for some milliseconds.
        rig.run_ms(20);
        rig.forget();
    }
}

/// While the cable is out every message is lost. The failsafe may end before a message can be sent.
#[test]
#[ignore = "takes long: make test-all"]
fn a_failsafe_that_began_while_the_cable_was_out_is_told_when_it_is_back() {
    for (out_ms, is_commanded) in [(700, true), (5000, true), (5000, false)] {
        let mut rig = hub();
        for output in 1..=OUTPUTS {
            rig.set(&format!("OUT{output}_TIMEOUT"), 300);
        }
        command(&mut rig, 0..OUTPUTS);
        rig.run_ms(30);
        rig.connect_node(false);
        rig.run_ms(out_ms);
        rig.forget();
        rig.connect_node(true);
        for _ in 0..100 {
            if is_commanded {
                command(&mut rig, 0..OUTPUTS);
            }
            rig.run_ms(20);
        }
        let told = rig.node_messages(|message| match message {
            Message::LogMessage(message) => Some(message.to_string()),
            _ => None,
        });
        let is_told = told.iter().any(|(_, text)| text.contains("FAILSAFE"));
        assert!(is_told, "{out_ms} ms, {is_commanded}: {told:?}");
    }
}

#[test]
fn an_invalid_entry_does_not_move_its_output_and_the_others_follow_theirs() {
    let mut rig = hub();
    command(&mut rig, 0..OUTPUTS);
    rig.run_ms(30);
    rig.send_commands(&[(1, PWM, 1200.0), (2, PWM, f32::NAN), (3, 77, 0.0), (4, PWM, 1300.0)]);
    let widths = rig.widths_us();
    assert_eq!(widths[..4], [Some(1200.0), Some(width_us(1)), Some(width_us(2)), Some(1300.0)]);
    // One line tells why an entry of the command was refused.
    rig.wait_for_line("refused: command from 10 tid 1, unknown type", 100);
}

#[test]
fn the_outputs_take_turns_in_actuator_status() {
    let mut rig = hub();
    command(&mut rig, 0..OUTPUTS);
    rig.run_ms(900);
    rig.forget();
    rig.run_ms(1600);
    let ids: Vec<u8> = rig
        .node_messages(|message| match message {
            Message::ActuatorStatus(status) => Some(status.actuator),
            _ => None,
        })
        .into_iter()
        .map(|(_, id)| id)
        .collect();
    assert!(
        (15..=17).contains(&ids.len()),
        "ten a second, whatever the number of outputs: {ids:?}"
    );
    assert!(ids.windows(2).all(|pair| pair[1] == pair[0] % 8 + 1), "{ids:?}");
}

/// Reads and sets all parameters of all outputs, and reads them after a restart.
#[test]
fn every_output_has_its_own_parameters_that_survive_a_restart() {
    let mut rig = hub();
    for output in 1..=8 {
        for (name, value) in [
            ("ID", 100 + output),
            ("MIN", 900 + output),
            ("TIMEOUT", 500 + output),
            ("FS", output % 4),
        ] {
            rig.set(&format!("OUT{output}_{name}"), value);
        }
    }
    let before = rig.parameters();
    rig.save();
    rig.restart();
    assert_eq!(rig.parameters(), before);
    let request = ParameterRequest { index: 500, ..ParameterRequest::default() };
    assert!(matches!(
        rig.ask(&Message::ParameterRequest(request)),
        Message::ParameterResponse(response) if response.name.is_empty()
    ));
}

/// Deviations of the pulses' edges from their times, in cycles, each with the number of times it
/// occurred.
#[derive(Default, Debug)]
struct Edges {
    rises: BTreeMap<i64, u64>,
    falls: BTreeMap<i64, u64>,
}

/// Runs the hub under a load for `seconds`. An autopilot commands all outputs at 50 Hz unless the
/// load itself has commands.
fn loaded(kind: Kind, seconds: u64) -> (Figures, Edges) {
    let load = Load { kind, priority: 31, pace: Pace::Full };
    let mut loaded = Loaded::with_rig(hub(), Some(load), Client::Walking);
    command(&mut loaded.rig, 0..OUTPUTS);
    loaded.run_ms(60);
    loaded.rig.board().take_output_pulses();
    let mut edges = Edges::default();
    let mut origin = None;
    for _ in 0..50 * seconds {
        loaded.run_ms(20);
        for (output, pulses) in (1..).zip(loaded.rig.board().take_output_pulses()) {
            assert!(
                (1..=2).contains(&pulses.len()) || pulses.is_empty(),
                "output {output}: {pulses:?}"
            );
            for pulse in pulses {
                let start = by_node_clock(pulse.start) as i64 - SLOT * output;
                let late = (start - *origin.get_or_insert(start) + PERIOD / 2).rem_euclid(PERIOD)
                    - PERIOD / 2;
                *edges.rises.entry(late).or_default() += 1;
                // Widths are whole ticks, and the interrupt handler delays all pulses alike.
                let width = pulse.width_cycles as i64;
                *edges
                    .falls
                    .entry(late + (width + TICK / 2).rem_euclid(TICK) - TICK / 2)
                    .or_default() += 1;
            }
        }
    }
    (loaded.finish(), edges)
}

/// ArduPilot commands the actuators 1 to 15 in one message, PX4 0 to 14. Each actuator moves with
/// its own phase.
#[test]
fn all_eight_outputs_follow_ardupilot_and_px4() {
    for (profile, first_id) in [(Profile::Ardupilot, 1), (Profile::Px4, 0)] {
        let mut rig = hub();
        for output in 0..OUTPUTS as i64 {
            rig.set(&format!("OUT{}_ID", output + 1), first_id + output);
        }
        rig.attach_autopilot(Settings { moves: Moves::All, ..Settings::of(profile) });
        rig.run_ms(200);
        pulses(&mut rig);
        rig.run_until(rig.now() + node_ms(5000));
        let ranges: Vec<(i64, i64)> = pulses(&mut rig)
            .iter()
            .map(|pulses| {
                let widths = pulses.iter().map(|(_, width)| width / 16);
                assert!(
                    (249..=251).contains(&pulses.len()),
                    "{profile:?}: {} pulses in 5 s",
                    pulses.len()
                );
                (widths.clone().min().unwrap_or_default(), widths.max().unwrap_or_default())
            })
            .collect();
        // The sweep takes four seconds, so each output reaches both ends.
        assert!(
            ranges.iter().all(|&(least, most)| least < 1020 && most > 1980),
            "{profile:?}: {ranges:?}"
        );
        // The autopilot may be connected during its first command.
        assert!(rig.serial.matches("broken").count() <= 1, "{}", rig.serial);
        let (health, code) = rig.status_now();
        assert_eq!((health, code & !TRANSFER_ERRORS), (OK, 0), "{profile:?}");
    }
}

#[test]
fn with_eight_outputs_at_full_load_no_frame_is_lost_and_each_edge_is_exact() {
    assert_exact_and_lossless(1);
}

#[test]
#[ignore = "takes long: make test-all"]
fn with_eight_outputs_the_same_holds_for_a_minute_of_each_load() {
    assert_exact_and_lossless(60);
}

#[track_caller]
fn assert_exact_and_lossless(seconds: u64) {
    for kind in [Kind::LongCommand, Kind::Status(8), Kind::Command(8)] {
        let (figures, edges) = loaded(kind, seconds);
        let meter = &figures.meter;
        println!(
            "{kind:?}: {} frames, release at most {} cycles, {edges:?}",
            meter.frames,
            meter.latency.max()
        );
        assert_eq!((meter.lost, meter.garbled, figures.stuck), (0, 0, false), "{kind:?}");
        assert!(
            meter.latency.max() <= 1600,
            "{kind:?}: a frame is released {} cycles after its end",
            meter.latency.max()
        );
        let all = || edges.rises.iter().chain(&edges.falls);
        assert!(
            edges.rises.values().sum::<u64>() > 7 * 50 * seconds * 3 / 4,
            "{kind:?}: {edges:?}"
        );
        // The first rise itself is late by less than a tick, so this compares the range of
        // deviations.
        let (least, most) =
            (all().map(|(late, _)| *late).min(), all().map(|(late, _)| *late).max());
        assert!(
            most.zip(least).is_some_and(|(most, least)| most - least <= TICK),
            "{kind:?}: {edges:?}"
        );
        assert_eq!(figures.periods.keys().collect::<Vec<_>>(), [&(PERIOD as u64)], "{kind:?}");
    }
}
