//! Several outputs: servos and motors.

use super::*;
use crate::hardware::OUTPUTS;
use crate::node::acceptance::Row;
use crate::tables::condition::Conditions;
use mcp2515_ordered::{Event, Notice};

const ARRAY_COMMAND: u32 = 0x1003_F20A;
const RAW_COMMAND: u32 = 0x0704_060A;
const ARMING_STATUS: u32 = 0x1804_4C0A;
#[cfg(feature = "safety")]
const SAFETY_STATE: u32 = 0x184E_200A;
#[cfg(feature = "log")]
const LOG_MESSAGE: u32 = 0x183F_FF78;
const PWM: u8 = 4;

/// A node with eight outputs in use.
fn hub() -> Rig {
    Rig::with(&[(Parameter::OutCount, OUTPUTS as i32)])
}

/// The frames of an ArrayCommand of pulse widths in microseconds, from node 10.
fn widths(commands: &[(u8, u16)]) -> Vec<Frame> {
    let entry = |&(id, width): &(u8, u16)| {
        let [low, high] = half::f16::from_f32(f32::from(width)).to_le_bytes();
        [id, PWM, low, high]
    };
    let payload: Vec<u8> = commands.iter().flat_map(entry).collect();
    golden::transfer(ARRAY_COMMAND, golden::ARRAY_COMMAND, 3, &payload)
}

impl Rig {
    /// Sets a parameter of an output, counted from 0.
    fn set_output(&mut self, output: usize, parameter: OutputParameter, value: i32) {
        assert!(self.program.node.parameters.set(parameter.index(output), value, InMemory));
        self.program.node.apply_parameters();
        self.settle();
    }

    /// Receives an ArrayCommand of pulse widths in microseconds, from node 10.
    fn widths(&mut self, commands: &[(u8, u16)]) {
        self.can.received.extend(widths(commands));
        self.settle();
    }

    /// Receives an esc.RawCommand from node 10. Each command is a multiple of 4.
    fn throttles(&mut self, payload: &str) {
        for frame in golden::transfer(RAW_COMMAND, golden::RAW_COMMAND, 4, &golden::bytes(payload))
        {
            self.can.received.push_back(frame);
        }
        self.settle();
    }

    fn arm(&mut self, status: u8) {
        self.hear(&golden::frame(ARMING_STATUS, &[status, 0xC0]));
    }

    /// The widths that the servos got, in microseconds.
    fn servos_us(&self) -> [u16; OUTPUTS] {
        self.servos.0.map(|ticks| ticks / 2)
    }
}

/// They have the same place in the table for a quick search.
#[test]
fn ids_that_differ_by_16_are_told_apart() {
    let mut rig = hub();
    for (output, id) in [(0, 5), (1, 21), (2, 37), (3, 255), (4, 239)] {
        rig.set_output(output, OutputParameter::Id, id);
    }
    rig.widths(&[(5, 1100), (21, 1200), (37, 1300), (255, 1400), (239, 1500), (53, 1900)]);
    assert_eq!(rig.servos_us()[..5], [1100, 1200, 1300, 1400, 1500]);
    assert_eq!(rig.program.node.health().counts.followed, 1, "a command of several entries");
}

/// While the parameters are applied, an output each turn, a list may come.
#[test]
fn of_outputs_that_share_an_id_those_that_keep_it_have_an_entry_of_their_own_at_once() {
    let mut rig = hub();
    for output in [2, 3, 5] {
        rig.set_output(output, OutputParameter::Id, 40);
    }
    let node = &mut rig.program.node;
    assert!(node.parameters.set(OutputParameter::Id.index(2), 41, InMemory));
    let outputs = &mut node.control.outputs;
    outputs.begin_update();
    let moved = [0, 1, 2].map(|_| outputs.update_next(&node.parameters).moved);
    assert_eq!(moved, [0, 0, 1 << 2 | 1 << 3 | 1 << 5]);
    let slots = [40, 41].map(|id| outputs.slot_of(id).expect("an output has it"));
    assert_eq!(slots.map(|slot| slot.bits), [1 << 3 | 1 << 5, 1 << 2]);
    assert_ne!(slots[0].at, slots[1].at);
    rig.settle();
    rig.widths(&[(41, 1100), (40, 1200)]);
    assert_eq!([2, 3, 5].map(|output| rig.servos_us()[output]), [1100, 1200, 1200]);
}

/// The lines of the serial monitor about superseded commands.
fn superseded_lines(rig: &Rig) -> Vec<String> {
    let log = String::from_utf8(rig.log.clone()).unwrap();
    log.lines().filter(|line| line.contains("superseded")).map(String::from).collect()
}

/// Of five commands for output 1 the node follows the first or the last, and of one for output 2
/// that one.
#[test]
fn commands_that_a_newer_one_replaced_are_counted_and_the_monitor_says_so_once() {
    let mut rig = hub();
    rig.widths(&[(1, 1100), (2, 1200)]);
    rig.run(2500);
    assert!(superseded_lines(&rig).is_empty());
    for round in 0..2 {
        let frames = (0..5).map(|n| width_from(10, 1300.0 + n as f32));
        rig.can.received.extend(frames);
        rig.settle();
        rig.run(2500);
        assert_eq!(superseded_lines(&rig), ["commands superseded 4"], "{round}");
    }
    rig.is_asked = true;
    rig.run(500);
    assert_eq!(superseded_lines(&rig)[1..], ["commands superseded 8"]);
}

/// A frame of a command for output 1 alone: a pulse width in microseconds, from a node.
fn width_from(source: u8, width_us: f32) -> Frame {
    let [low, high] = half::f16::from_f32(width_us).to_le_bytes();
    golden::frame(ARRAY_COMMAND & !0x7F | u32::from(source), &[1, PWM, low, high, 0xC0])
}

/// A node whose outputs 7 and 8 are motors with the indices 0 and 1.
fn with_motors() -> Rig {
    let mut rig = hub();
    for (output, index) in [(6, 0), (7, 1)] {
        rig.set_output(output, OutputParameter::Type, 1);
        rig.set_output(output, OutputParameter::Id, index);
    }
    rig
}

/// Full speed, and half speed.
const FULL_AND_HALF: &str = "FF 7C 01 00";
#[test]
fn a_motor_is_in_failsafe_once_the_arming_status_is_missing_for_its_time() {
    for heard_ms in [0, 300, 999] {
        let mut rig = with_motors();
        rig.run(heard_ms);
        rig.arm(255);
        rig.throttles(FULL_AND_HALF);
        rig.run(4000);
        assert_eq!((rig.servos_us()[6..].to_vec(), rig.code()), (vec![1000; 2], 0));
        rig.run(1000 + 2 * OUTPUTS as u32);
        assert_eq!(rig.code(), Conditions::FAILSAFE.code(), "{heard_ms}");
    }
}

#[test]
fn an_output_has_two_commanders_if_another_commands_it_within_two_seconds() {
    for (later_ms, code) in [(2000, Conditions::TWO_COMMANDERS.code()), (2002, 0)] {
        let mut rig = Rig::with(&[(Parameter::OutCount, 2), (OutputParameter::Timeout.of(0), 0)]);
        rig.hear(&width_from(10, 1200.0));
        rig.run(later_ms);
        rig.hear(&width_from(11, 1300.0));
        assert_eq!(rig.code(), code, "{later_ms}");
    }
}

/// Commands were missing for a reason.
#[cfg(feature = "safety")]
#[test]
fn the_safety_switch_ends_the_doubt_about_a_motor_s_commands() {
    let mut rig = with_motors();
    rig.arm(255);
    rig.throttles(FULL_AND_HALF);
    rig.run(300);
    rig.hear(&golden::frame(SAFETY_STATE, &[0, 0xC0]));
    rig.arm(255);
    rig.run(100);
    assert_eq!(rig.code() & Conditions::FAILSAFE.code(), 0, "the switch is on");
    rig.hear(&golden::frame(SAFETY_STATE, &[255, 0xC0]));
    rig.run(300);
    rig.arm(255);
    rig.run(100);
    assert_eq!(rig.code(), Conditions::FAILSAFE.code(), "it is off, and no command comes");
}

#[test]
fn a_motor_has_the_pulse_for_no_throttle_from_its_first_command_on_unless_mot_idle_is_0() {
    for (idle, width_us) in [(1, 1000), (0, 0)] {
        let mut rig = with_motors();
        rig.set(Parameter::MotIdle, idle);
        rig.run(20);
        assert_eq!(rig.servos_us()[6..], [0, 0], "no command");
        for _ in 0..20 {
            rig.throttles(FULL_AND_HALF);
            rig.run(20);
            assert_eq!(rig.servos_us()[6..], [width_us; 2], "not armed");
        }
        rig.arm(255);
        rig.throttles(FULL_AND_HALF);
        assert_eq!(rig.servos_us()[6..], [2000, 1500]);
    }
}

/// At each start of ArduPilot, and at its safety switch.
#[cfg(feature = "safety")]
#[test]
fn the_monitor_says_why_commands_are_refused_and_when_that_is_over() {
    for (required, lines) in [
        (0, ["safety switch on", "over: safety switch on"].as_slice()),
        (1, ["disarmed", "safety switch on", "disarmed", "over: disarmed"].as_slice()),
    ] {
        let mut rig = Rig::with(&[(Parameter::ArmReq, required)]);
        rig.status_of(10);
        rig.run(10);
        for (safety, arming) in [(0, 0), (255, 0), (255, 255)] {
            rig.hear(&golden::frame(SAFETY_STATE, &[safety, 0xC0]));
            rig.arm(arming);
            // In each second a condition has one line.
            rig.run(1100);
        }
        let log = String::from_utf8(rig.log.clone()).unwrap();
        let found: Vec<_> = log
            .lines()
            .filter(|line| {
                !line.contains("rx") && (line.contains("armed") || line.contains("switch"))
            })
            .collect();
        assert_eq!(found, lines);
    }
}

/// The node's LogMessages: level and text.
#[cfg(feature = "log")]
fn told(rig: &Rig) -> Vec<(u8, String)> {
    rig.transfers(LOG_MESSAGE, golden::LOG_MESSAGE)
        .into_iter()
        .map(|(_, payload, _)| (payload[0] >> 5, String::from_utf8(payload[1..].into()).unwrap()))
        .collect()
}

/// An event of the CAN controller.
#[cfg(feature = "log")]
fn notice(rig: &mut Rig, event: Event, value: u8) {
    rig.program.node.notice(Notice { event, value });
}

/// Causes a condition, or ends its cause. One that passes has no end of its cause.
#[cfg(feature = "log")]
fn cause(rig: &mut Rig, condition: Conditions, on: bool) {
    match condition {
        Conditions::ID_CONFLICT if on => {
            rig.hear(&golden::frame(NODE_STATUS, &[0, 0, 0, 0, 0, 0, 0, 0xC0]));
        }
        Conditions::FRAMES_LOST if on => notice(rig, Event::Flags, 1 << 7),
        Conditions::ERROR_PASSIVE => notice(rig, Event::Flags, u8::from(on) << 4),
        Conditions::BUS_OFF if on => notice(rig, Event::Flags, 1 << 5),
        Conditions::TWO_COMMANDERS if on => {
            rig.widths(&[(1, 1500)]);
            let mut other = widths(&[(1, 1400)]);
            for frame in &mut other {
                *frame = golden::frame(ARRAY_COMMAND + 1, frame.data());
            }
            rig.can.received.extend(other);
            rig.settle();
            rig.set_output(0, OutputParameter::Timeout, 0);
        }
        Conditions::FAILSAFE if on => {
            rig.set_output(0, OutputParameter::Timeout, 100);
            rig.widths(&[(1, 1500)]);
        }
        Conditions::FAILSAFE => {
            rig.set_output(0, OutputParameter::Timeout, 0);
            rig.widths(&[(1, 1500)]);
        }
        Conditions::TEMPERATURE => rig.readings = [if on { 246 } else { 51 }; 2],
        Conditions::POWER => rig.set(Parameter::Pwr1VoltMin, if on { 60_000 } else { 0 }),
        Conditions::PARAMETERS_LOST => rig.program.node.record.health.set(condition, on),
        Conditions::DISARMED => rig.set(Parameter::ArmReq, on.into()),
        _ => assert!(!on),
    }
}

/// Each condition of the table.
#[cfg(feature = "log")]
#[test]
fn each_condition_is_told_by_monitor_and_log_message_when_it_begins_and_when_it_is_over() {
    for condition in golden::CONDITIONS {
        if condition.told().is_empty() || condition == Conditions::CONTROLLER {
            continue;
        }
        let mut rig = Rig::with(&[(Parameter::PwrRate, 1), (Parameter::Pwr1VoltMult, 5000)]);
        rig.run(1500);
        rig.log.clear();
        rig.can.sent.clear();
        cause(&mut rig, condition, true);
        rig.run(1500);
        let text = crate::tables::condition::TEXTS[usize::from(condition.number())];
        let text = text.replace("%a", "1");
        assert_eq!(told(&rig), [(2, text.clone())]);
        cause(&mut rig, condition, false);
        rig.run(12_000);
        let over = format!("over: {text}");
        assert_eq!(told(&rig), [(2, text.clone()), (1, over.clone())]);
        let log = String::from_utf8(rig.log.clone()).unwrap();
        let lines: Vec<_> = log.lines().filter(|line| line.ends_with(&text)).collect();
        assert_eq!(lines, [text, over], "{log}");
    }
}

#[cfg(feature = "log")]
#[test]
fn each_event_of_the_controller_is_told_by_its_own_text_when_it_begins_and_when_it_is_over() {
    for (event, text) in [
        (Event::NotKeeping, "SI SO SCK? register 43"),
        (Event::NotStarting, "CAN H/L: never idle (43)"),
        (Event::Lost, "5V? MCP2515 settings lost"),
        (Event::IntWrong, "INT open or shorted"),
        (Event::AnotherRate, "another bit rate or crystal"),
        (Event::GaveUpSending, "CAN H/L: not sent (1)"),
    ] {
        let mut rig = Rig::with(&[]);
        rig.run(1500);
        rig.can.sent.clear();
        notice(&mut rig, event, 43);
        rig.run(1500);
        assert_eq!(told(&rig), [(2, text.to_string())]);
        rig.run(12_000);
        assert_eq!(told(&rig)[1..], [(1, format!("over: {text}"))]);
        let log = String::from_utf8(rig.log.clone()).unwrap();
        assert_eq!(log.lines().filter(|line| line.ends_with(text)).count(), 2, "{log}");
    }
}

/// The ground station's last word about it must be right, whenever the commands come back.
#[cfg(feature = "log")]
#[test]
fn the_last_message_about_a_failsafe_is_its_end_after_any_gap_in_the_commands() {
    for gap_ms in (120..700).step_by(20) {
        let mut rig = hub();
        rig.set_output(2, OutputParameter::Timeout, 100);
        rig.run(1000);
        rig.widths(&[(3, 1500)]);
        rig.run(gap_ms);
        rig.can.sent.clear();
        for _ in 0..100 {
            rig.widths(&[(3, 1500)]);
            rig.run(20);
        }
        let told = told(&rig);
        let end = (1, "over: FAILSAFE: no commands".to_string());
        assert_eq!(told.last(), Some(&end), "{gap_ms} ms: {told:?}");
    }
}

/// PX4 without UAVCAN_PUB_ARM sends no ArmingStatus.
#[cfg(feature = "log")]
#[test]
fn commands_above_idle_that_are_refused_for_two_seconds_because_nobody_armed_are_a_condition() {
    const DISARMED: u16 = 1 << 14;
    let refused = |payload: &str, ms: u32| {
        let mut rig = hub();
        rig.set_output(4, OutputParameter::Type, 1);
        rig.set_output(4, OutputParameter::Id, 0);
        rig.can.sent.clear();
        for _ in 0..ms / 20 {
            rig.throttles(payload);
            rig.run(20);
        }
        rig
    };
    assert_eq!(refused("00 00", 5000).code(), 0, "idle");
    assert_eq!(refused("04 00", 1900).code(), 0);
    let mut rig = refused("04 00", 3100);
    assert_eq!((rig.code(), rig.level()), (DISARMED, 0));
    rig.run(600);
    assert_eq!(told(&rig), [(2, "commands refused: disarmed".to_string())]);
    rig.arm(255);
    for _ in 0..150 {
        rig.throttles("04 00");
        rig.run(20);
    }
    assert_eq!(rig.code(), 0);
    assert_eq!(told(&rig)[1..], [(1, "over: commands refused: disarmed".to_string())]);
}

/// They are looked at one after the other.
#[cfg(feature = "log")]
#[test]
fn outputs_that_fail_together_are_named_together() {
    let mut rig = hub();
    rig.widths(&[(1, 1500), (3, 1500), (8, 1500)]);
    rig.run(2000);
    rig.widths(&[(3, 1500)]);
    rig.run(1000);
    let texts = ["FAILSAFE: no commands", "FAILSAFE of output 138", "FAILSAFE of output 18"];
    assert_eq!(told(&rig), texts.map(|text| (2, text.to_string())));
}

#[test]
fn a_lost_frame_is_no_warning_while_each_output_gets_its_next_command_within_50_ms() {
    let lost = Notice { event: Event::Flags, value: 1 << 7 };
    for (period_ms, level) in [(20, 0), (49, 0), (60, 1)] {
        let mut rig = hub();
        rig.widths(&[(1, 1500), (2, 1500)]);
        rig.program.node.notice(lost);
        for time in 1..=240 {
            rig.run(1);
            if time % 20 == 0 {
                rig.widths(&[(1, 1500)]);
            }
            if time % period_ms == 0 {
                assert_eq!(rig.code(), 1 << 5, "the bit stays");
                // Just before the second output gets its next command.
                assert_eq!(rig.level(), level, "{period_ms} ms");
                rig.widths(&[(2, 1500)]);
            }
        }
        rig.run(100);
        assert_eq!(rig.level(), 1, "the commands have stopped");
    }
    let mut rig = hub();
    rig.program.node.notice(lost);
    assert_eq!(rig.level(), 1, "without commands");
}

/// Node 10 flies the motors. Node 50 moves a servo, and says that it is disarmed.
#[test]
fn another_commander_with_an_output_of_its_own_does_not_stop_the_motors() {
    let mut rig = with_motors();
    for n in 0..150 {
        if n % 25 == 0 {
            rig.arm(255);
            rig.hear(&golden::frame(ARMING_STATUS & !0x7F | 50, &[0, 0xC0]));
        }
        rig.throttles(FULL_AND_HALF);
        rig.hear(&width_from(50, 1200.0 + n as f32));
        rig.run(20);
        assert_eq!(rig.servos_us()[6..], [2000, 1500], "{n}");
    }
    assert_eq!((rig.servos_us()[0], rig.code()), (1349, 0), "one commander for each output");
    rig.arm(0);
    rig.run(20);
    assert_eq!(rig.servos_us()[6..], [1000, 1000], "the motors' own commander disarms them");
}

/// Neither what the list has for the old ID, nor what a list without an end had for the new one.
#[test]
fn an_output_that_gets_another_id_in_the_middle_of_a_list_follows_nothing_before() {
    let mut rig = hub();
    rig.hear(&widths(&[(7, 1900), (1, 1500), (2, 1500)])[0]);
    let frames = widths(&[(8, 1200), (1, 1500), (2, 1600)]);
    rig.hear(&frames[0]);
    rig.set_output(7, OutputParameter::Id, 7);
    frames[1..].iter().for_each(|frame| rig.hear(frame));
    rig.run(20);
    assert_eq!(rig.servos_us(), [1500, 1600, 0, 0, 0, 0, 0, 0]);
    rig.widths(&[(7, 1700), (8, 1100)]);
    assert_eq!(rig.servos_us()[6..], [1700, 1700], "outputs 7 and 8 have ID 7");
}

/// ArduPilot leaves channels out when it has disarmed, up to half a second before it says so.
#[test]
fn a_motor_stops_at_once_when_its_commander_leaves_it_out() {
    let mut rig = with_motors();
    rig.arm(255);
    for (payload, expected) in [(FULL_AND_HALF, [2000, 1500]), ("FF 7C", [2000, 1000])] {
        rig.throttles(payload);
        rig.run(10);
        assert_eq!(rig.servos_us()[6..], expected, "{payload}");
    }
}

#[test]
fn a_single_motor_lets_raw_commands_through_the_filters() {
    let mut rig = Rig::new();
    for (kind, row) in [(0, Row::WITH_ID), (1, Row::WITH_MOTORS)] {
        rig.set_output(0, OutputParameter::Type, kind);
        rig.run(5000);
        assert_eq!(rig.program.node.acceptance(InMemory).row, row);
    }
}

#[test]
fn the_thesis_command_goes_over_the_travel() {
    let mut rig = Rig::new();
    for (position, width_us) in [(0, 1000), (255, 2000), (51, 1200)] {
        rig.log.clear();
        rig.hear(&golden::frame(0x1004_570A, &[position, 0xC0]));
        rig.run(20);
        assert_eq!(rig.servos_us()[0], width_us, "{position}");
        let log = String::from_utf8_lossy(&rig.log);
        assert!(log.contains("ServoCommand"), "{log}");
    }
}

/// The outputs are looked at one after the other.
#[test]
fn an_id_that_is_set_while_another_is_applied_is_applied_too() {
    let mut rig = hub();
    for (output, id) in [(7, 20), (0, 21)] {
        let parameter = OutputParameter::Id.index(output);
        assert!(rig.program.node.parameters.set(parameter, id, InMemory));
        rig.program.node.apply_parameters();
        for _ in 0..3 {
            rig.turn();
        }
    }
    rig.settle();
    rig.widths(&[(20, 1100), (21, 1200)]);
    assert_eq!((rig.servos_us()[0], rig.servos_us()[7]), (1200, 1100));
}

/// It was refused, because nobody is armed.
#[test]
fn a_command_for_the_old_index_of_a_motor_gives_no_pulse() {
    let mut rig = Rig::with(&[(OutputParameter::Type.of(0), 1), (OutputParameter::Id.of(0), 0)]);
    rig.throttles(FULL_AND_HALF);
    rig.set_output(0, OutputParameter::Id, 9);
    rig.run(20);
    assert_eq!(rig.servos_us()[0], 0);
}

/// Maybe the commands have another identifier now.
#[test]
fn the_filters_are_set_anew_once_no_output_is_commanded_and_not_while_one_is() {
    for (goes_on, times) in [(true, 0), (false, 1)] {
        let mut rig = hub();
        rig.widths(&[(1, 1500), (2, 1500)]);
        let before = rig.can.filters_set;
        for _ in 0..100 {
            if goes_on {
                rig.widths(&[(2, 1500)]);
            }
            rig.run(50);
        }
        assert_eq!(rig.can.filters_set - before, times, "commands for output 2 go on: {goes_on}");
    }
}

/// Commands come faster than they are followed.
#[test]
fn of_many_commands_the_newest_is_followed_and_every_output_has_its_turn() {
    let mut rig = hub();
    for width in 1000..1200 {
        rig.can.received.extend((1..=8).flat_map(|id| widths(&[(id, width)])));
    }
    let mut before = [0; OUTPUTS];
    while !rig.can.received.is_empty() {
        rig.turn();
        let now = rig.servos_us();
        assert!(now.iter().zip(before).all(|(now, before)| *now >= before), "an older command");
        before = now;
    }
    assert!(before.iter().all(|width| *width > 1100), "an output waits: {before:?}");
    rig.settle();
    assert_eq!(rig.servos_us(), [1199; OUTPUTS]);
}

/// What was to be resumed, or was missed, was for the old ID.
#[cfg(feature = "safety")]
#[test]
fn an_output_with_another_id_has_no_failsafe_before_a_command_for_it() {
    const STEPS: [fn(&mut Rig); 3] = [
        |rig| rig.hear(&golden::frame(SAFETY_STATE, &[0, 0xC0])),
        |rig| rig.set_output(0, OutputParameter::Id, 5),
        |rig| rig.hear(&golden::frame(SAFETY_STATE, &[255, 0xC0])),
    ];
    for (order, silent_ms) in [([0, 1, 2], 0), ([0, 1, 2], 200), ([1, 0, 2], 0), ([1, 0, 2], 200)] {
        let mut rig = hub();
        rig.set_output(0, OutputParameter::Fs, 2);
        rig.set_output(0, OutputParameter::Timeout, 100);
        rig.widths(&[(1, 1900)]);
        rig.run(silent_ms);
        order.into_iter().for_each(|step| STEPS[step](&mut rig));
        rig.run(1000);
        assert_eq!(rig.servos_us()[0], 0, "{order:?} after {silent_ms} ms");
        assert_eq!(rig.program.node.control.outputs.failing(), 0, "{order:?} after {silent_ms} ms");
    }
}
