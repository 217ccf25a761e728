//! The simulator's ArduPilot and PX4: the node follows each, with only parameters changed.

use std::fs::File;
use std::io::{BufRead, BufReader};

use bench::Cycles;
use bench::autopilot::{Profile, Settings};
use bench::can::Frame;
use bench::dronecan::Message;
use flate2::read::GzDecoder;
use rig::manage::ms_between;
use rig::status::{DISARMED, ERROR, FAILSAFE, OK};
use rig::{MS, Program, Rig, has_all_features, status_fields};

const ARDUPILOT: u32 = 10;
const PX4: u32 = 1;

/// A running node with these parameters, and this autopilot.
fn flying(profile: Profile, actuator: u8, parameters: &[(&str, i64)]) -> Rig {
    flying_as(Settings::of(profile), actuator, parameters)
}

/// The same, with more settings.
fn flying_as(settings: Settings, actuator: u8, parameters: &[(&str, i64)]) -> Rig {
    let mut rig = Rig::running();
    rig.set_all(parameters);
    rig.attach_autopilot(Settings { actuator, ..settings });
    rig.autopilot().hold(0.5);
    rig.run_ms(30);
    rig.forget();
    rig
}

#[track_caller]
fn assert_follows(rig: &mut Rig) {
    for deflection in [0.5, -1.0, 1.0, 0.0, -0.25] {
        rig.autopilot().hold(deflection);
        rig.run_ms(30);
        assert_eq!(rig.settled_pulse_us(), 1500.0 + 500.0 * deflection);
    }
}

/// Indices of the frames that begin a transfer.
fn starts(frames: &[(Cycles, Vec<u8>)]) -> Vec<usize> {
    let begins = |data: &[u8]| data.last().is_some_and(|tail| tail & 0x80 != 0);
    (0..frames.len()).filter(|&n| begins(&frames[n].1)).collect()
}

#[test]
fn ardupilot_s_first_servo_needs_no_parameter() {
    let mut rig = flying(Profile::Ardupilot, 1, &[]);
    assert_follows(&mut rig);
    let starts = starts(&rig.frames(0x0803_F200 | ARDUPILOT));
    assert!(
        starts.len() > 10 && starts.windows(2).all(|pair| pair[1] - pair[0] == 9),
        "fifteen commands are nine frames"
    );
}

#[test]
fn ardupilot_s_other_servos_need_only_out1_id() {
    for actuator in [2, 8, 15] {
        let mut rig = flying(Profile::Ardupilot, actuator, &[("OUT1_ID", i64::from(actuator))]);
        assert_follows(&mut rig);
    }
}

#[test]
fn it_follows_ardupilot_s_pulse_widths() {
    let mut rig = flying(Profile::ArdupilotPwm, 3, &[("OUT1_ID", 3)]);
    assert_follows(&mut rig);
}

#[test]
fn it_follows_px4_s_servos_counted_from_0() {
    // Before June 2026 PX4 had eight commands in a message.
    for (actuator, servos, count) in [(0, 15, 9), (14, 15, 9), (7, 8, 5)] {
        let settings = Settings { servos, ..Settings::of(Profile::Px4) };
        let mut rig = flying_as(settings, actuator, &[("OUT1_ID", i64::from(actuator))]);
        assert_follows(&mut rig);
        let frames = rig.frames(0x0603_F200 | PX4);
        let starts = starts(&frames);
        assert!(
            starts.len() > 10 && starts.windows(2).all(|pair| pair[1] - pair[0] == count),
            "{servos} commands are {count} frames"
        );
    }
}

/// Each pulse has the width of a command of about the last 20 ms, so no command of nine frames is
/// lost.
#[test]
fn it_follows_each_step_of_a_sweep() {
    for (profile, actuator) in [(Profile::Ardupilot, 15), (Profile::Px4, 14)] {
        let mut rig = flying(profile, actuator, &[("OUT1_ID", i64::from(actuator))]);
        let now = rig.now();
        rig.autopilot().sweep(now);
        rig.run_ms(60);
        rig.forget();
        for _ in 0..4000 / 20 {
            rig.run_ms(20);
            let at = rig.now();
            let Some(last) = rig.pulses.last().copied() else { panic!("no pulse") };
            let commanded = |t| 1500.0 + 500.0 * rig_deflection(&mut rig, t);
            // When the pulse began, the newest command could be 20 ms old; the pulse is up to 20 ms
            // old, too.
            let (now, then) = (last.start, last.start - 45 * MS);
            let steps: Vec<f64> = (0..=45).map(|ms| then + ms * MS).map(commanded).collect();
            let (least, most) =
                steps.iter().fold((f64::MAX, f64::MIN), |(a, b), us| (a.min(*us), b.max(*us)));
            let width = last.width_us();
            assert!(
                (least - 1.0..=most + 1.0).contains(&width),
                "{width} us at {} ({least} to {most})",
                now / MS
            );
            assert!(at - last.start < 25 * MS);
        }
    }
}

fn rig_deflection(rig: &mut Rig, at: u64) -> f64 {
    rig.autopilot().deflection(at)
}

#[test]
fn both_send_the_arming_status_that_arm_req_requires() {
    for (profile, actuator) in [(Profile::Ardupilot, 1), (Profile::Px4, 1)] {
        let mut rig = flying(profile, actuator, &[("ARM_REQ", 1), ("OUT1_FS", 3)]);
        rig.run_ms(600);
        assert_follows(&mut rig);
        rig.autopilot().set_armed(false);
        rig.run_ms(700);
        rig.forget();
        rig.run_ms(200);
        assert_eq!(rig.pulses, [], "disarmed");
        rig.autopilot().set_armed(true);
        rig.run_ms(700);
        assert_follows(&mut rig);
    }
}

#[test]
fn both_request_and_receive_the_node_s_information() {
    for profile in [Profile::Ardupilot, Profile::Px4] {
        let mut rig = flying(profile, 1, &[]);
        rig.run_ms(1500);
        let events = rig.autopilot().take_events();
        let [(_, text)] = &events[..] else { panic!("{events:?}") };
        assert!(text.starts_with("120 is org."), "{text}");
        assert!(rig.broken.is_empty(), "{:?}", rig.broken);
    }
}

#[test]
fn when_the_autopilot_stops_sending_the_failsafe_begins() {
    let mut rig = flying(Profile::Ardupilot, 1, &[("OUT1_FS", 1), ("OUT1_TIMEOUT", 200)]);
    rig.run_ms(500);
    rig.autopilot().set_silent(true);
    let silent_from = rig.now();
    rig.run_ms(400);
    assert_eq!(rig.settled_pulse_us(), 1500.0);
    let last = rig.pulses.iter().rfind(|pulse| pulse.width_us() == 1750.0).unwrap();
    assert!((150.0..230.0).contains(&ms_between(silent_from, last.start)));
    rig.autopilot().set_silent(false);
    rig.run_ms(60);
    assert_eq!(rig.settled_pulse_us(), 1750.0);
}

/// A node whose output 3 is a motor with the index 2: the throttle of a Plane on SERVO3.
fn with_throttle() -> Rig {
    let parameters = [("OUT_COUNT", 3), ("OUT3_TYPE", 1), ("OUT3_ID", 2)];
    let mut rig = Program::Full.running_set(&parameters);
    rig.attach_autopilot(Settings {
        servos: 2,
        motors: 3,
        omits_disarmed: true,
        ..Settings::of(Profile::Ardupilot)
    });
    rig.autopilot().hold(1.0);
    rig
}

/// Time of the last pulse of output 3 with power, if there is one since the last call.
fn last_power(rig: &mut Rig) -> Option<Cycles> {
    let pulses = rig.board().take_output_pulses().swap_remove(1);
    pulses.iter().rfind(|pulse| pulse.width_us() > 1100.0).map(|pulse| pulse.start)
}

/// ArduPlane with `ARMING_REQUIRE` 2 sends no RawCommand while disarmed. Of its own disarms, 12 of
/// 20 were a failsafe for the ground station, and 4 of 20 re-armings were refused.
#[test]
#[ignore = "takes long: make test-all"]
fn of_100_disarms_of_ardupilot_none_is_a_failsafe_and_the_motor_stops_at_mot_timeout() {
    let mut rig = with_throttle();
    for n in 0..100 {
        rig.autopilot().set_armed(true);
        // So the disarms come at each phase of the ArmingStatus.
        rig.run_ms(805 + n % 10);
        let disarmed = rig.now();
        assert!(last_power(&mut rig).is_some_and(|at| ms_between(at, disarmed) < 25.0), "{n}");
        rig.autopilot().set_armed(false);
        rig.run_ms(700);
        // It stops at once if the next ArmingStatus comes before the next pulse.
        let held_ms = last_power(&mut rig).map_or(0.0, |at| ms_between(disarmed, at));
        assert!((0.0..210.0).contains(&held_ms), "{n}: {held_ms} ms");
    }
    let statuses = rig.statuses();
    assert!(statuses.len() > 140);
    for (at, data) in statuses {
        let (_, level, _, code) = status_fields(&data);
        assert_eq!((level, code & FAILSAFE), (OK, 0), "at {} ms", at / MS);
    }
    assert!(!rig.serial.contains("FAILSAFE"), "{}", rig.serial);
}

/// The commands for motors stop, and ArmingStatus still says armed.
#[test]
#[ignore = "takes long: make test-all"]
fn commands_that_are_lost_while_armed_are_a_failsafe_with_the_next_arming_status() {
    for phase_ms in [0, 100, 200, 300, 400] {
        let mut rig = with_throttle();
        rig.run_ms(1500 + phase_ms);
        rig.forget();
        let now = rig.now();
        rig.autopilot().set_motors(0, now);
        rig.wait_for_line("FAILSAFE: no commands", 200 + 500 + 20);
        // Which output it is comes in the next second.
        rig.wait_for_line("FAILSAFE of output 3", 1000);
        assert_eq!(rig.next_status(), (ERROR, FAILSAFE), "{phase_ms}");
    }
}

/// The frames of a recording in tests/data, each with its time in it.
fn recording(name: &str) -> Vec<(Cycles, Frame)> {
    let path = format!("{}/data/{name}.log.gz", env!("CARGO_MANIFEST_DIR"));
    let file = File::open(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
    let lines = BufReader::new(GzDecoder::new(file)).lines().map(Result::unwrap);
    let frame = |line: String| {
        let (time, frame) = line.strip_prefix('(')?.split_once(") can0 ")?;
        let micros: f64 = time.parse::<f64>().ok()? * 1e6;
        Some((micros as u64 * MS / 1000, frame.parse().ok()?))
    };
    lines.map(|line| frame(line).expect("a line of candump -L")).collect()
}

/// The real PX4 read all parameters, armed, commanded four motors and two servos, disarmed, armed
/// again, and was killed (tests/data/px4).
#[test]
fn what_the_real_px4_sent_is_answered_followed_and_ends_in_a_failsafe() {
    let mut rig = Program::Full.running();
    rig.set("OUT_COUNT", 6);
    for motor in 1..=4 {
        rig.set(&format!("OUT{motor}_TYPE"), 1);
        rig.set(&format!("OUT{motor}_ID"), motor - 1);
    }
    for (name, actuator) in [("OUT5_ID", 0), ("OUT6_ID", 1)] {
        rig.set(name, actuator);
    }
    rig.save();
    let eeprom = rig.board().avr().eeprom();
    let mut rig = Program::Full.running_with(&eeprom);
    rig.forget();
    let begin = rig.now();
    let frames = recording("px4/motors");
    for (at, frame) in &frames {
        rig.peer.borrow_mut().send_at(begin + at, *frame);
    }
    let widths = |rig: &mut Rig, ms: u64| {
        rig.run_until(begin + ms * MS);
        let first = rig.pulses.last().copied();
        let further = rig.board().take_output_pulses();
        let all = std::iter::once(first).chain(further.iter().map(|of| of.last().copied()));
        all.map(|pulse| pulse.map_or(0.0, |pulse| pulse.width_us().round())).collect::<Vec<_>>()
    };
    for (ms, motors) in [
        (10_000, [1000.0; 4]),
        (10_700, [1100.0, 1200.0, 1300.0, 1400.0]),
        (12_100, [1200.0; 4]),
        (13_300, [1300.0; 4]),
        (15_150, [1500.0; 4]),
        (15_900, [1000.0; 4]),
        (17_600, [1500.0; 4]),
    ] {
        let widths = widths(&mut rig, ms);
        assert_eq!(widths[..4], motors, "{ms} ms");
        let command =
            rig.transfers.iter().rev().find_map(|(_, transfer)| match Message::decode(transfer) {
                Message::ArrayCommand(commands) => Some(commands),
                _ => None,
            });
        let commands = command.expect("a command");
        assert_eq!(commands.len(), 15);
        for (servo, command) in commands.iter().take(2).enumerate() {
            let expected = 1500.0 + 500.0 * f64::from(command.value.to_f32());
            assert!((widths[4 + servo] - expected).abs() <= 12.0, "{ms} ms: {widths:?}");
        }
    }
    let answers = rig
        .transfers
        .iter()
        .filter(|(_, transfer)| matches!(Message::decode(transfer), Message::ParameterResponse(_)));
    assert_eq!(answers.count(), 117);
    assert_eq!(rig.broken, []);
    // The motors stop at MOT_TIMEOUT, and the failsafe comes when ArmingStatus is missed, too.
    assert_eq!(widths(&mut rig, 18_000)[..4], [1000.0; 4]);
    rig.wait_for_line("FAILSAFE of output", 6000);
    assert_eq!(rig.next_status().0, ERROR);
}

/// The real PX4 had a file for the board on its card, and asked a node that takes no updates 69
/// times (tests/data/px4). Each request has several frames, between those of the commands.
#[test]
#[ignore = "takes long: make test-all"]
fn what_the_real_px4_sent_while_an_update_was_refused_disturbs_no_command() {
    let mut rig = Rig::running();
    rig.set("OUT1_ID", 0);
    rig.forget();
    let begin = rig.now();
    let frames = recording("px4/update-refused");
    for (at, frame) in &frames {
        rig.peer.borrow_mut().send_at(begin + at, *frame);
    }
    let (end, _) = frames.last().expect("a frame");
    rig.run_until(begin + end);
    let all: Vec<Message> =
        rig.transfers.iter().map(|(_, transfer)| Message::decode(transfer)).collect();
    let is_request = |message: &&Message| matches!(message, Message::BeginUpdate(_));
    let is_refusal = |message: &&Message| match message {
        Message::UpdateBegun(answer) => answer.number == 1,
        _ => false,
    };
    assert_eq!(all.iter().filter(is_request).count(), 69);
    assert_eq!(all.iter().filter(is_refusal).count(), 69, "INVALID_MODE");
    assert_eq!(rig.broken, []);
    assert_eq!(rig.pulses.last().map(|pulse| pulse.width_us().round()), Some(1500.0));
    let disarmed = if has_all_features() { DISARMED } else { 0 };
    assert_eq!(rig.next_status(), (OK, disarmed));
}
