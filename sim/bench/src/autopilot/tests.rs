//! Tests of the autopilot.

use super::*;
use crate::can::Id;
use crate::dronecan::{
    ActuatorCommand, Allocation, Assembler, CommandUnit, NodeInfo, NodeStatus, Outcome,
    ParameterResponse, Value,
};

const MS: Cycles = F_CPU_HZ / 1000;

fn with(settings: Settings) -> Autopilot {
    Autopilot::new(settings, 1_000_000)
}

fn like(profile: Profile) -> Autopilot {
    with(Settings::of(profile))
}

fn autopilot(command_type: CommandType) -> Autopilot {
    with(Settings { command_type, ..Settings::default() })
}

/// Messages that `autopilot` sends before `until`.
fn sent(autopilot: &mut Autopilot, until: Cycles) -> Vec<(Cycles, Message)> {
    let mut assembler = Assembler::new();
    let frames = autopilot.due(until);
    let decode = |(at, frame): (Cycles, Frame)| {
        let Id::Extended(id) = frame.id else { panic!("standard frame") };
        match assembler.push(id, frame.data(), crate::elapsed(at)) {
            Outcome::Complete(transfer) => Some((at, Message::decode(&transfer))),
            Outcome::Partial => None,
            other => panic!("{other:?}"),
        }
    };
    frames.into_iter().filter_map(decode).collect()
}

/// Lets `autopilot` receive a transfer that ends at `at`.
fn receive(autopilot: &mut Autopilot, at: Cycles, id: u32, message: &Message) {
    let id = CanId::parse(id).unwrap();
    for frame in frames(id, TransferId::new(7), message) {
        autopilot.receive(at, &frame);
    }
}

fn status(uptime_s: u32) -> Message {
    Message::NodeStatus(NodeStatus { uptime_s, ..NodeStatus::default() })
}

/// Times, in milliseconds, at which a frame with this identifier is sent before `until`.
fn times_of(autopilot: &mut Autopilot, id: u32, until: Cycles) -> Vec<u64> {
    let frames = autopilot.due(until).into_iter();
    frames.filter(|(_, frame)| frame.id == Id::Extended(id)).map(|(at, _)| at / MS).collect()
}

/// Texts of the messages before `until` that begin with `name`, with their milliseconds.
fn texts_of(autopilot: &mut Autopilot, name: &str, until: Cycles) -> Vec<(u64, String)> {
    let messages = sent(autopilot, until).into_iter();
    let texts = messages.map(|(at, message)| (at / MS, message.to_string()));
    texts.filter(|(_, text)| text.starts_with(name)).collect()
}

#[test]
fn the_autopilot_sends_a_status_and_fifty_commands_a_second_whatever_the_steps() {
    let at_once = sent(&mut autopilot(CommandType::Unitless), 10 * F_CPU_HZ);
    let uptimes = at_once.iter().filter_map(|(_, message)| match message {
        Message::NodeStatus(status) => Some(status.uptime_s),
        _ => None,
    });
    assert!(uptimes.eq(0..10), "a status each second, with true seconds");
    let commands = at_once.iter().filter(|(_, m)| matches!(m, Message::ArrayCommand(_))).count();
    assert_eq!((commands, at_once.len()), (500, 510));
    assert!(at_once.is_sorted_by_key(|(at, _)| *at));
    let mut pieces = autopilot(CommandType::Unitless);
    let stepped: Vec<_> = (1..=10_000).flat_map(|ms| sent(&mut pieces, ms * MS)).collect();
    assert_eq!(at_once, stepped);
}

#[test]
fn a_held_position_is_sent_in_each_unit() {
    let cases = [
        (CommandType::Unitless, "ArrayCommand id 1 unitless +0.50"),
        (CommandType::Position, "ArrayCommand id 1 position +0.39 rad"),
        (CommandType::Pwm, "ArrayCommand id 1 PWM 1750 us"),
        (CommandType::Thesis, "thesis.ServoCommand 191"),
    ];
    for (command_type, expected) in cases {
        let mut autopilot = autopilot(command_type);
        autopilot.hold(0.5);
        let messages = sent(&mut autopilot, COMMAND_OFFSET + 1);
        assert_eq!(messages.last().unwrap().1.to_string(), expected);
    }
}

#[test]
fn one_actuator_is_held_while_the_others_move_until_the_next_sweep() {
    let mut autopilot = with(Settings { moves: Moves::All, ..Settings::of(Profile::Px4) });
    let of = |autopilot: &Autopilot, id: usize| match autopilot.command(F_CPU_HZ / 3) {
        Some(Message::ArrayCommand(commands)) => f64::from(commands[id].value),
        other => panic!("{other:?}"),
    };
    let (moving, other) = (of(&autopilot, 3), of(&autopilot, 4));
    autopilot.hold_actuator(3, 0.5);
    assert_eq!((of(&autopilot, 3), of(&autopilot, 4)), (0.5, other));
    assert_ne!(moving, 0.5);
    autopilot.sweep(0);
    assert_eq!(of(&autopilot, 3), moving);
}

#[test]
fn a_sweep_starts_at_the_present_deflection() {
    let mut autopilot = autopilot(CommandType::Unitless);
    autopilot.hold(-0.75);
    autopilot.sweep(12_345);
    assert!((autopilot.deflection(12_345) + 0.75).abs() < 1e-9);
    autopilot.nudge(-0.5, 12_345);
    assert_eq!(autopilot.deflection(99_999), -1.0);
}

/// A silenced autopilot must not send its backlog later.
#[test]
fn messages_that_are_due_during_silence_are_not_sent_later() {
    let mut autopilot = autopilot(CommandType::Unitless);
    autopilot.set_silent(true);
    assert!(sent(&mut autopilot, 5 * F_CPU_HZ).is_empty());
    autopilot.set_silent(false);
    let messages = sent(&mut autopilot, 6 * F_CPU_HZ);
    assert_eq!(messages.len(), 51);
    assert!(messages.iter().all(|(at, _)| *at >= 5 * F_CPU_HZ));
}

/// The commands of the first ArrayCommand.
fn first_commands(autopilot: &mut Autopilot) -> Vec<ActuatorCommand> {
    let messages = sent(autopilot, COMMAND_OFFSET + 1);
    let Some((_, Message::ArrayCommand(commands))) = messages.last() else {
        panic!("{messages:?}")
    };
    commands.clone()
}

/// PX4 of before June 2026 has eight.
#[test]
fn ardupilot_commands_actuators_from_1_and_px4_from_0_each_with_its_identifier() {
    let px4 = |servos| Settings { actuator: 0, servos, ..Settings::of(Profile::Px4) };
    for (settings, held, id, frames, actuators) in [
        (Settings::of(Profile::Ardupilot), 0.5, 0x0803_F20A, 9, 1..=15),
        (px4(15), -1.0, 0x0603_F201, 9, 0..=14),
        (px4(8), -1.0, 0x0603_F201, 5, 0..=7),
    ] {
        let held_one = || {
            let mut autopilot = with(settings.clone());
            autopilot.hold(held);
            autopilot
        };
        let sent: Vec<_> = held_one().due(COMMAND_OFFSET + 1).split_off(1);
        assert_eq!(sent.len(), frames, "{settings:?}");
        let is_right =
            |(at, frame): &(Cycles, Frame)| *at == COMMAND_OFFSET && frame.id == Id::Extended(id);
        assert!(sent.iter().all(is_right), "{sent:?}");
        let commands = first_commands(&mut held_one());
        let ids: Vec<u8> = commands.iter().map(|command| command.actuator).collect();
        assert_eq!(ids, actuators.collect::<Vec<u8>>());
        assert!(commands.iter().all(|command| command.unit == CommandUnit::Unitless));
        let values: Vec<f32> = commands.iter().map(|command| command.value.to_f32()).collect();
        assert_eq!(f64::from(values[0]), held);
        // The others sweep.
        assert!(values[1..].is_sorted() && values[1] != values[2], "{values:?}");
    }
}

#[test]
fn all_actuators_sweep_each_with_its_own_phase() {
    let all = |profile, motion| {
        let settings = Settings { moves: Moves::All, ..Settings::of(profile) };
        let servos = if profile == Profile::Px4 { 8 } else { settings.servos };
        let mut autopilot = with(Settings { servos, ..settings });
        autopilot.motion = motion;
        let commands = first_commands(&mut autopilot).into_iter();
        commands.map(|command| command.value.to_f32()).collect::<Vec<_>>()
    };
    let values = all(Profile::Px4, Motion::Sweep { since: COMMAND_OFFSET, phase: 0.0 });
    let expected = [0.0, 0.707, 1.0, 0.707, 0.0, -0.707, -1.0, -0.707];
    let near = |(value, expected): (&f32, f32)| (value - expected).abs() < 0.002;
    assert!(values.iter().zip(expected).all(near), "{values:?}");
    let mut values = all(Profile::Ardupilot, Motion::Sweep { since: 0, phase: 0.0 });
    values.sort_by(f32::total_cmp);
    values.dedup();
    assert_eq!(values.len(), 15);
    assert_eq!(all(Profile::Ardupilot, Motion::Hold(-0.5)), [-0.5; 15]);
}

/// Time in milliseconds and commands of each RawCommand before `until`.
fn motor_commands(autopilot: &mut Autopilot, until: Cycles) -> Vec<(u64, Vec<i16>)> {
    let plain = |(at, message)| match message {
        Message::RawCommand(commands) => Some((at / MS, commands)),
        _ => None,
    };
    sent(autopilot, until).into_iter().filter_map(plain).collect()
}

#[test]
fn a_held_motor_has_its_power_until_the_next_sweep_and_late_motors_send_no_burst() {
    let mut autopilot = like(Profile::Ardupilot);
    assert_eq!(motor_commands(&mut autopilot, F_CPU_HZ), []);
    autopilot.set_motors(2, F_CPU_HZ);
    autopilot.hold_motor(1, 0.5);
    let commands = motor_commands(&mut autopilot, F_CPU_HZ * 3 / 2);
    assert!((20..=30).contains(&commands.len()), "{}", commands.len());
    assert!(commands.iter().all(|(_, powers)| powers[1] == 4096), "{commands:?}");
    autopilot.sweep(F_CPU_HZ * 3 / 2);
    let commands = motor_commands(&mut autopilot, 2 * F_CPU_HZ);
    assert!(commands.iter().any(|(_, powers)| powers[1] != 4096), "{commands:?}");
}

#[test]
fn motors_are_off_while_disarmed_and_follow_the_motion_while_armed() {
    for (profile, idle) in [(Profile::Ardupilot, 0), (Profile::Px4, 1)] {
        let mut autopilot = with(Settings { motors: 2, ..Settings::of(profile) });
        autopilot.hold(-1.0);
        assert_eq!(motor_commands(&mut autopilot, F_CPU_HZ / 50), [(15, vec![idle; 2])]);
        autopilot.hold(1.0);
        assert_eq!(motor_commands(&mut autopilot, F_CPU_HZ / 25), [(35, vec![8191; 2])]);
        autopilot.set_armed(false);
        assert_eq!(motor_commands(&mut autopilot, F_CPU_HZ * 3 / 50), [(55, vec![0; 2])]);
        autopilot.set_armed(true);
        autopilot.motion = Motion::Sweep { since: F_CPU_HZ * 75 / 1000, phase: 0.25 };
        assert_eq!(motor_commands(&mut autopilot, F_CPU_HZ / 10)[0], (75, vec![8191, idle]));
        assert_eq!(motor_commands(&mut autopilot, F_CPU_HZ * 11 / 10).len(), 50);
    }
}

/// As ArduPilot with `ARMING_REQUIRE` 2, whose next ArmingStatus says it up to 500 ms later.
#[test]
fn commands_for_motors_stop_at_once_with_arming_if_the_actuators_that_move_are_left_out() {
    let settings = Settings { motors: 3, omits_disarmed: true, ..Settings::of(Profile::Ardupilot) };
    let mut autopilot = with(settings);
    assert_eq!(motor_commands(&mut autopilot, F_CPU_HZ * 6 / 10).len(), 30);
    autopilot.set_armed(false);
    assert!(motor_commands(&mut autopilot, F_CPU_HZ).is_empty());
    assert_eq!(times_of(&mut autopilot, 0x1804_4C0A, 2 * F_CPU_HZ), [1012, 1512]);
    autopilot.set_armed(true);
    assert_eq!(motor_commands(&mut autopilot, 3 * F_CPU_HZ).len(), 50);
}

#[test]
fn motors_are_commanded_with_the_priority_of_the_profile_and_only_if_there_are_any() {
    for (profile, motors, id, frames) in [
        (Profile::Ardupilot, 20, 0x0704_060A, 6),
        (Profile::ArdupilotPwm, 4, 0x0704_060A, 1),
        (Profile::Px4, 8, 0x0004_0601, 3),
        (Profile::Px4, 0, 0x0004_0601, 0),
        (Profile::Plain, 4, 0x0004_0601, 0),
    ] {
        let mut autopilot = with(Settings { motors, ..Settings::of(profile) });
        assert_eq!(times_of(&mut autopilot, id, F_CPU_HZ / 50), vec![15; frames], "{profile:?}");
        assert!(motors <= profile.motors_max() || profile.motors().is_none());
    }
    let draft = Settings { motors: 4, ..Settings::of(Profile::Px4) }.in_dialect(Dialect::Draft);
    assert_eq!(times_of(&mut with(draft), 0x0004_0601, F_CPU_HZ), []);
}

/// Three commands of three frames each wait for a busy bus; more would be old.
#[test]
fn commands_for_many_motors_wait_for_a_busy_bus_and_old_ones_are_dropped() {
    let settings =
        Settings { servos: 0, motors: 8, motor_rate_hz: 400, ..Settings::of(Profile::Ardupilot) };
    let mut autopilot = with(settings);
    let mut queued = |ms: u64| {
        autopilot.advance(ms * F_CPU_HZ / 1000);
        autopilot.station.borrow().queued()
    };
    assert!((15..22).map(&mut queued).is_sorted());
    assert!(queued(22) >= 9);
    let most = (23..60).map(queued).max().unwrap();
    assert!(most < 40, "{most}");
}

#[test]
fn a_new_node_gets_get_node_info_requests_until_it_responds() {
    let mut autopilot = like(Profile::Ardupilot);
    const REQUEST: u32 = 0x1001_F88A;
    receive(&mut autopilot, 16_000, 0x1801_5578, &status(0));
    assert_eq!(times_of(&mut autopilot, REQUEST, 2 * F_CPU_HZ + F_CPU_HZ / 2), [3, 1003, 2003]);
    let info = NodeInfo { name: b"org.example.servo".to_vec(), ..NodeInfo::default() };
    receive(&mut autopilot, 2 * F_CPU_HZ, 0x1001_0AF8, &Message::NodeInfo(Box::new(info)));
    assert_eq!(times_of(&mut autopilot, REQUEST, 4 * F_CPU_HZ), []);
    let events = autopilot.take_events();
    assert!(events[0].1.starts_with("120 is org.example.servo software 0.0"), "{events:?}");
    // The same node without, then with a restart.
    receive(&mut autopilot, 3 * F_CPU_HZ, 0x1801_5578, &status(3));
    assert_eq!(times_of(&mut autopilot, REQUEST, 5 * F_CPU_HZ), []);
    receive(&mut autopilot, 5 * F_CPU_HZ, 0x1801_5578, &status(0));
    assert_eq!(times_of(&mut autopilot, REQUEST, 5 * F_CPU_HZ + F_CPU_HZ / 2), [5000, 5002]);
}

/// ArduPilot reads a parameter by its name and not by its index.
#[test]
fn a_parameter_of_each_new_node_is_read_by_name_and_reported() {
    let parameter = Some("OUT1_MAX".into());
    let mut autopilot = with(Settings { parameter, ..Settings::of(Profile::Ardupilot) });
    let info = Message::NodeInfo(Box::default());
    receive(&mut autopilot, F_CPU_HZ, 0x1001_0AF8, &info);
    receive(&mut autopilot, 2 * F_CPU_HZ, 0x1001_0AF8, &info);
    let requests = texts_of(&mut autopilot, "param.", 3 * F_CPU_HZ);
    assert_eq!(requests, [(1002, String::from("param.GetSet request OUT1_MAX"))]);
    let value = Value::Integer(2000);
    let response = ParameterResponse { value, name: b"OUT1_MAX".into(), ..Default::default() };
    receive(&mut autopilot, 4 * F_CPU_HZ, 0x100B_0AF8, &Message::ParameterResponse(response));
    assert_eq!(autopilot.take_events().last().unwrap().1, "120 has OUT1_MAX = 2000");
}

#[test]
fn a_node_that_is_offline_gets_no_more_requests() {
    let mut autopilot = like(Profile::Px4);
    receive(&mut autopilot, 0, 0x1801_5578, &status(0));
    assert_eq!(times_of(&mut autopilot, 0x1E01_F881, 20 * F_CPU_HZ), [2, 1002, 2002, 3002]);
}

#[test]
fn the_autopilot_answers_get_node_info() {
    let mut autopilot = like(Profile::Px4);
    receive(&mut autopilot, F_CPU_HZ, 0x1E01_81FF, &Message::NodeInfoRequest);
    let name = "GetNodeInfo response org.pixhawk.pixhawk";
    let answers = texts_of(&mut autopilot, name, 2 * F_CPU_HZ);
    assert_eq!(answers.len(), 1);
    assert_eq!(answers[0].0, (F_CPU_HZ + ANSWER_DELAY) / MS);
}

#[test]
fn the_autopilot_allocates_node_ids_only_if_it_is_set_to() {
    for allocates in [false, true] {
        let mut autopilot = with(Settings { allocates, ..Settings::default() });
        let mut answers = Vec::new();
        for (first, len, at) in [(0, 6, 100), (6, 6, 300), (12, 4, 500)] {
            let request = Allocation {
                node_id: 0,
                first_part: first == 0,
                unique_id: (first..first + len).collect(),
            };
            receive(&mut autopilot, at * MS, 0x1E97_4D00, &Message::Allocation(request));
            let texts = texts_of(&mut autopilot, "Allocation", (at + 100) * MS).into_iter();
            answers.extend(texts.map(|(at, text)| format!("{at} {text}")));
        }
        let expected = [
            "102 Allocation unique ID 000102030405",
            "302 Allocation unique ID 000102030405060708090A0B",
            "502 Allocation node ID 125 unique ID 000102030405060708090A0B0C0D0E0F",
        ];
        assert_eq!(answers, if allocates { &expected[..] } else { &[] });
        assert_eq!(autopilot.take_events().len(), usize::from(allocates));
    }
}

#[test]
fn the_next_command_type_is_one_of_the_profile() {
    for mut autopilot in [autopilot(CommandType::Thesis), like(Profile::Ardupilot)] {
        autopilot.next_command_type();
        assert_eq!(autopilot.settings().command_type, CommandType::Unitless);
    }
}

#[test]
fn the_autopilot_can_send_only_its_status_or_only_commands_in_either_dialect() {
    let sent = |settings: Settings| {
        let mut autopilot = with(settings);
        let frames = autopilot.due(2 * F_CPU_HZ);
        let commands = autopilot.commands_sent();
        (frames.len(), commands, frames[1].1.to_string())
    };
    for (dialect, status, command) in [
        (Dialect::V0, "10015501#01000000000000C1", "0803F201#"),
        (Dialect::Draft, "11340409#010000000000", "084C0409#"),
    ] {
        let with = |only| Settings { only: Some(only), ..Settings::default().in_dialect(dialect) };
        assert_eq!(sent(with(Only::Status)), (2, 0, String::from(status)));
        let (frames, commands, text) = sent(with(Only::Commands));
        assert_eq!((frames, commands), (100, 100));
        assert!(text.starts_with(command), "{text}");
    }
    let only = Settings { only: Some(Only::Status), ..Settings::of(Profile::Ardupilot) };
    assert_eq!(sent(only).0, 2, "no ArmingStatus");
}

#[test]
fn an_autopilot_that_starts_later_has_uptime_0_and_sends_nothing_before() {
    let mut autopilot = Autopilot::powered(Settings::default(), 1_000_000, 10 * F_CPU_HZ);
    let messages = sent(&mut autopilot, 12 * F_CPU_HZ);
    assert_eq!(messages.len(), 2 + 100);
    assert!(messages.iter().all(|(at, _)| *at >= 10 * F_CPU_HZ));
    assert_eq!(messages[0].1, status(0));
    assert_eq!(messages[51].1, status(1));
}
