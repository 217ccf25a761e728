//! Several outputs: servos and motors.

use super::manage::{RESTART, set};
use super::*;
use crate::hardware::OUTPUTS;
use crate::node::acceptance::Row;
use crate::node::agenda::{FRAMES_BEFORE_ENTRY, Turn};
use crate::tables::condition::{Conditions, Level};
use crate::tables::parameters::OutputParameter;

const ARRAY_COMMAND: u32 = 0x1003_F20A;
const RAW_COMMAND: u32 = 0x0704_060A;
const ARMING_STATUS: u32 = 0x1804_4C0A;
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

#[test]
fn each_output_follows_the_entries_for_its_id() {
    let mut rig = hub();
    rig.widths(&[
        (1, 1100),
        (2, 1200),
        (3, 1300),
        (4, 1400),
        (5, 1500),
        (6, 1600),
        (7, 1700),
        (8, 1800),
        (9, 1900),
    ]);
    assert_eq!(rig.servos_us(), [1100, 1200, 1300, 1400, 1500, 1600, 1700, 1800]);
    rig.widths(&[(9, 1000), (5, 1550)]);
    assert_eq!(rig.servos_us(), [1100, 1200, 1300, 1400, 1550, 1600, 1700, 1800]);
    assert_eq!(
        rig.program.node.health().counts.followed,
        2,
        "a command of several entries counts once"
    );
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
}

#[test]
fn outputs_with_the_same_id_follow_the_same_entry() {
    let mut rig = hub();
    for output in [2, 6, 7] {
        rig.set_output(output, OutputParameter::Id, 40);
    }
    rig.widths(&[(40, 1234)]);
    assert_eq!(rig.servos_us(), [0, 0, 1234, 0, 0, 0, 1234, 1234]);
}

#[test]
fn outputs_that_are_not_in_use_follow_nothing() {
    let mut rig = Rig::with(&[(Parameter::OutCount, 3)]);
    rig.widths(&[(1, 1100), (2, 1200), (3, 1300), (4, 1400), (8, 1800)]);
    assert_eq!(rig.servos_us(), [1100, 1200, 1300, 0, 0, 0, 0, 0]);
}

/// The commands come faster than their entries are followed.
#[test]
fn of_many_commands_the_newest_is_followed_and_every_output_has_its_turn() {
    let mut rig = hub();
    for n in 0..200u16 {
        let [low, high] = half::f16::from_f32(f32::from(1000 + n)).to_le_bytes();
        for id in 1..=8 {
            rig.can.received.push_back(golden::frame(ARRAY_COMMAND, &[id, PWM, low, high, 0xC0]));
        }
    }
    let mut highest = [0; OUTPUTS];
    while !rig.can.received.is_empty() {
        rig.turn();
        let now = rig.servos_us();
        assert!(
            now.iter().zip(&highest).all(|(now, before)| now >= before),
            "an older command replaced a newer one"
        );
        highest = now;
    }
    let slowest = highest.into_iter().min().unwrap();
    assert!(slowest > 1100, "an output waits for ever: {highest:?}");
    rig.settle();
    assert_eq!(rig.servos_us(), [1199; OUTPUTS]);
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

/// A node with one output, and these frames in its queue.
fn one_output(frames: impl IntoIterator<Item = Frame>) -> Rig {
    let mut rig = Rig::with(&[]);
    rig.can.received.extend(frames);
    rig
}

#[test]
fn a_single_output_follows_the_newest_of_commands_that_come_too_fast() {
    let mut rig = one_output((0..40).map(|n| width_from(10, 1000.0 + n as f32)));
    rig.settle();
    assert_eq!(rig.servos_us()[0], 1039);
    let followed = rig.program.node.health().counts.followed;
    assert!(followed <= 20, "{followed} of 40");
}

#[test]
fn a_command_is_followed_as_soon_as_no_frame_waits_and_after_some_frames_in_any_case() {
    let other = golden::frame(ARMING_STATUS, &[0, 0xC0]);
    let most = usize::from(FRAMES_BEFORE_ENTRY);
    for (others, taken) in [(0, 0), (2, 2), (40, most)] {
        let frames = core::iter::once(width_from(10, 1200.0));
        let mut rig = one_output(frames.chain(core::iter::repeat_n(other, others)));
        while rig.turn() != Turn::Follow {
            assert_eq!(rig.servos_us()[0], 0);
        }
        assert_eq!((rig.servos_us()[0], others - rig.can.received.len()), (1200, taken));
    }
}

/// The command of node 10 waits. Node 11 sends what no output follows.
#[test]
fn a_rejected_command_of_another_node_does_not_replace_one_that_waits() {
    let broken = width_from(11, f32::NAN);
    let mut rig = one_output([width_from(10, 1200.0), broken, broken, broken]);
    rig.settle();
    assert_eq!(rig.servos_us()[0], 1200);
    assert_eq!(rig.program.node.health().counts.refused, 3);
}

/// Outputs 1 and 2 have the same ID, so they share a slot. The slot of output 2 alone has the entry
/// of an old command.
#[test]
fn an_output_whose_id_changes_while_its_entry_waits_does_not_follow_an_old_one() {
    let mut rig = hub();
    rig.widths(&[(1, 1100), (2, 1900)]);
    rig.set_output(1, OutputParameter::Id, 1);
    let [low, high] = half::f16::from_f32(1200.0).to_le_bytes();
    for _ in 0..20 {
        rig.can.received.push_back(golden::frame(ARRAY_COMMAND, &[1, PWM, low, high, 0xC0]));
    }
    while !rig.program.node.has_entry() {
        rig.turn();
    }
    rig.servos.0[1] = 0;
    rig.can.received.clear();
    assert!(rig.program.node.parameters.set(OutputParameter::Id.index(1), 2, InMemory));
    rig.program.node.apply_parameters();
    rig.settle();
    // It may have followed the command that came for its ID before.
    assert!(matches!(rig.servos_us()[..2], [1200, 0 | 1200]), "{:?}", rig.servos_us());
}

#[test]
fn an_entry_that_cannot_be_followed_is_refused_and_the_others_are_followed() {
    let mut rig = hub();
    let refused = rig.program.node.health().counts.refused;
    rig.widths(&[(1, 1100), (2, 0), (3, 1300)]);
    assert_eq!(rig.servos_us()[..3], [1100, 0, 1300]);
    assert_eq!(rig.program.node.health().counts.refused, refused + 1);
}

#[test]
fn what_waits_is_not_followed_after_the_vehicle_was_disarmed() {
    let mut rig = hub();
    rig.set(Parameter::ArmReq, 1);
    rig.arm(255);
    let [low, high] = half::f16::from_f32(1700.0).to_le_bytes();
    for frame in golden::transfer(
        ARRAY_COMMAND,
        golden::ARRAY_COMMAND,
        3,
        &[1, PWM, low, high, 2, PWM, low, high],
    ) {
        rig.can.received.push_back(frame);
    }
    while !rig.program.node.has_entry() {
        rig.turn();
    }
    rig.can.received.push_back(golden::frame(ARMING_STATUS, &[0, 0xC0]));
    rig.settle();
    assert!(rig.servos_us()[..2].contains(&0), "{:?}", rig.servos_us());
    assert!(
        rig.log.windows(8).any(|text| text == b"disarmed")
            || rig.program.node.health().counts.refused > 0
    );
}

#[test]
fn each_output_has_a_failsafe_of_its_own() {
    let mut rig = hub();
    rig.set_output(3, OutputParameter::Timeout, 100);
    rig.set_output(3, OutputParameter::Fs, 2);
    rig.set_output(3, OutputParameter::FsPwm, 1900);
    let all: Vec<_> = (1..=8).map(|id| (id, 1500)).collect();
    rig.widths(&all);
    rig.run(150);
    assert_eq!(rig.servos_us(), [1500, 1500, 1500, 1900, 1500, 1500, 1500, 1500]);
    assert_eq!(rig.code(), Conditions::FAILSAFE.code());
    rig.widths(&[(1, 1600)]);
    assert_eq!(rig.code(), Conditions::FAILSAFE.code(), "another output's command does not end it");
    rig.widths(&[(4, 1600)]);
    assert_eq!(rig.code(), 0);
    rig.run(1100);
    assert_eq!(rig.servos_us()[3], 1900, "again");
}

#[test]
fn counts_and_rates_that_do_not_go_together_are_refused() {
    for (count, rate, fits) in [
        (8, 50, true),
        (8, 51, false),
        (7, 57, true),
        (7, 58, false),
        (4, 100, true),
        (3, 134, false),
        (1, 333, true),
    ] {
        let mut parameters = golden::parameters(&[]);
        assert!(parameters.set(Parameter::OutCount.index(), count, InMemory));
        assert_eq!(
            parameters.set(Parameter::OutRate.index(), rate, InMemory),
            fits,
            "{count} at {rate} Hz"
        );
        assert_eq!(parameters.outputs(), count as u8);
        let mut parameters = golden::parameters(&[(Parameter::OutRate, rate)]);
        assert_eq!(
            parameters.set(Parameter::OutCount.index(), count, InMemory),
            fits,
            "{count} at {rate} Hz"
        );
    }
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
const BOTH_OFF: &str = "00 00 00 00";

#[test]
fn a_motor_follows_raw_commands_only_while_armed_and_stops_when_disarmed() {
    let mut rig = with_motors();
    rig.throttles(FULL_AND_HALF);
    assert_eq!(rig.servos_us()[6..], [0, 0], "never armed");
    rig.arm(255);
    rig.throttles(FULL_AND_HALF);
    assert_eq!(rig.servos_us()[6..], [2000, 1500]);
    rig.throttles(BOTH_OFF);
    assert_eq!(rig.servos_us()[6..], [1000, 1000]);
    rig.throttles(FULL_AND_HALF);
    rig.arm(0);
    rig.run(20);
    assert_eq!(rig.servos_us()[6..], [1000, 1000]);
    assert_eq!(rig.code(), 0, "disarmed is no failsafe");
}

#[test]
fn a_motor_whose_commands_stop_is_off_after_mot_timeout_whatever_out_fs_and_out_timeout_say() {
    let mut rig = with_motors();
    rig.set_output(6, OutputParameter::Timeout, 0);
    rig.set_output(7, OutputParameter::Fs, 0);
    for timeout_ms in [200, 1000] {
        rig.set(Parameter::MotTimeout, timeout_ms);
        rig.arm(255);
        rig.throttles(FULL_AND_HALF);
        // Each output is looked at once in eight milliseconds.
        rig.run(timeout_ms as u32 + 1);
        assert_eq!(rig.servos_us()[6..], [2000, 1500], "{timeout_ms}");
        rig.run(OUTPUTS as u32);
        assert_eq!(rig.servos_us()[6..], [1000, 1000], "{timeout_ms}");
        assert_eq!(rig.code(), 0, "it may have disarmed");
        rig.arm(255);
        rig.run(OUTPUTS as u32);
        assert_eq!(rig.code(), Conditions::FAILSAFE.code());
    }
}

/// Times of ArduPilot: a RawCommand each 20 ms, an ArmingStatus each 500 ms.
const COMMAND_MS: u32 = 20;
const ARMING_MS: u32 = 500;

/// Runs an autopilot that disarms `phase` milliseconds after an ArmingStatus, and stops its
/// commands then.
fn assert_disarms_without_failsafe(timeout_ms: i32, phase: u32) {
    let mut rig = with_motors();
    rig.set(Parameter::MotTimeout, timeout_ms);
    rig.arm(255);
    let disarms = ARMING_MS + phase;
    let stops = disarms / COMMAND_MS * COMMAND_MS + timeout_ms as u32;
    for ms in 0..disarms + 1000 {
        if ms % COMMAND_MS == 0 && ms <= disarms {
            rig.throttles(FULL_AND_HALF);
        }
        if ms % ARMING_MS == 0 {
            rig.arm(if ms <= disarms { 255 } else { 0 });
        }
        rig.run(1);
        assert_eq!(rig.code(), 0, "{timeout_ms} ms, {phase} ms, at {ms} ms");
        if ms < disarms {
            assert_eq!(rig.servos_us()[6..], [2000, 1500], "{phase} ms, at {ms} ms");
        } else if ms > stops + OUTPUTS as u32 {
            assert_eq!(rig.servos_us()[6..], [1000, 1000], "{phase} ms, at {ms} ms");
        }
    }
    rig.arm(255);
    rig.throttles(FULL_AND_HALF);
    assert_eq!(rig.servos_us()[6..], [2000, 1500]);
    assert!(!String::from_utf8_lossy(&rig.log).contains("FAILSAFE"));
}

/// ArduPilot with `ARMING_REQUIRE` 2 stops its commands when it disarms.
#[test]
fn a_motor_whose_autopilot_disarms_stops_at_mot_timeout_and_is_never_in_failsafe() {
    for (timeout_ms, step) in [(50, 20), (200, 4), (600, 20)] {
        for phase in (0..ARMING_MS).step_by(step) {
            assert_disarms_without_failsafe(timeout_ms, phase);
        }
    }
}

#[test]
fn a_motor_is_in_failsafe_once_its_own_commander_says_that_it_is_still_armed() {
    let mut rig = with_motors();
    rig.arm(255);
    rig.throttles(FULL_AND_HALF);
    rig.hear(&width_from(50, 1200.0));
    rig.run(300);
    // Another commander's says nothing about the motors.
    for status in [0, 255] {
        rig.hear(&golden::frame(ARMING_STATUS & !0x7F | 50, &[status, 0xC0]));
        rig.run(OUTPUTS as u32);
        assert_eq!(rig.code(), 0, "{status}");
    }
    rig.arm(255);
    rig.run(OUTPUTS as u32);
    assert_eq!((rig.code(), rig.level()), (Conditions::FAILSAFE.code(), Level::Error as u8));
    rig.throttles(FULL_AND_HALF);
    assert_eq!(rig.code(), 0);
}

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

#[cfg(feature = "safety")]
#[test]
fn the_safety_switch_counts_as_on_for_four_to_five_seconds() {
    for begin_ms in [1, 500, 999] {
        let mut rig = hub();
        rig.run(begin_ms);
        rig.widths(&[(1, 1500)]);
        rig.hear(&golden::frame(0x184E_200A, &[0, 0xC0]));
        rig.run(4000);
        assert_eq!(rig.code(), Conditions::DISARMED.code(), "{begin_ms}");
        rig.run(1002);
        assert_eq!(rig.code(), 0, "{begin_ms}");
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
    const SAFETY_STATE: u32 = 0x184E_200A;
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

/// ArduPilot leaves channels out when it has disarmed, up to half a second before it says so.
#[test]
fn a_motor_stops_at_once_when_its_commander_leaves_it_out() {
    let mut rig = with_motors();
    rig.arm(255);
    rig.throttles(FULL_AND_HALF);
    assert_eq!(rig.servos_us()[6..], [2000, 1500]);
    rig.throttles("FF 7C");
    rig.run(10);
    assert_eq!(rig.servos_us()[6..], [2000, 1000]);
}

#[test]
fn neither_command_moves_an_output_of_the_other_type() {
    let mut rig = with_motors();
    rig.arm(255);
    // Both indices are IDs, too.
    rig.widths(&[(0, 1800), (1, 1700), (7, 1800), (8, 1800)]);
    assert_eq!(rig.servos_us(), [1700, 0, 0, 0, 0, 0, 0, 0]);
    rig.throttles(FULL_AND_HALF);
    assert_eq!(rig.servos_us(), [1700, 0, 0, 0, 0, 0, 2000, 1500]);
    rig.set_output(0, OutputParameter::Type, 1);
    let before = rig.program.node.pulse(0);
    rig.text("1004570A 80 C0");
    assert_eq!(rig.program.node.pulse(0), before, "the thesis's command is for a servo");
}

/// ArduPilot leaves out channels without a pulse while it is disarmed, and does not arm while the
/// node is at ERROR.
#[test]
fn a_missing_command_is_an_error_unless_the_autopilot_says_that_it_is_disarmed() {
    for (status, level) in [(Some(0), Level::Ok), (Some(255), Level::Error), (None, Level::Error)] {
        let mut rig = hub();
        rig.widths(&[(1, 1500)]);
        for _ in 0..6 {
            if let Some(status) = status {
                rig.arm(status);
            }
            rig.run(500);
        }
        let code = Conditions::FAILSAFE.code();
        assert_eq!((rig.code(), rig.level()), (code, level as u8), "{status:?}");
        rig.run(5000);
        assert_eq!(rig.level(), Level::Error as u8, "no ArmingStatus any more");
    }
}

/// An autopilot (node 10) flies motors. A companion (node 50) commands a servo, fifty times a
/// second, and says that it is disarmed.
#[test]
fn another_commander_with_an_output_of_its_own_does_not_stop_the_motors() {
    let mut rig = with_motors();
    for n in 0..300 {
        let companion = width_from(50, 1200.0 + n as f32);
        if n % 25 == 0 {
            rig.arm(255);
            rig.hear(&golden::frame(ARMING_STATUS & !0x7F | 50, &[0, 0xC0]));
        }
        rig.throttles(FULL_AND_HALF);
        rig.hear(&companion);
        rig.run(20);
        if n > 50 {
            assert_eq!(rig.servos_us()[6..], [2000, 1500], "{n}");
        }
    }
    assert_eq!(rig.servos_us()[0], 1499);
    assert_eq!(rig.code(), 0, "an output each is no second commander");
    rig.arm(0);
    rig.run(20);
    assert_eq!(rig.servos_us()[6..], [1000, 1000]);
}

#[cfg(feature = "update")]
#[test]
fn an_update_is_accepted_from_a_disarmed_autopilot_and_called_off_if_it_arms_before_it_begins() {
    const UPDATE: &str = "1E28F8FF 00 66 77 2E 62 69 6E C9";
    let mut rig = hub();
    rig.program.node.update.start(true);
    rig.widths(&[(1, 1500)]);
    assert!(!rig.ask(UPDATE).starts_with("1E287FF8 00"), "commanded, and nobody says disarmed");
    rig.arm(255);
    assert!(!rig.ask(UPDATE).starts_with("1E287FF8 00"), "armed");
    rig.arm(0);
    rig.widths(&[(1, 1500)]);
    rig.text(UPDATE);
    rig.run(20);
    rig.arm(255);
    rig.run(500);
    assert!(!rig.is_to_restart, "armed before it began");
    rig.arm(0);
    for _ in 0..20 {
        rig.widths(&[(1, 1500)]);
        rig.run(20);
        rig.arm(0);
    }
    assert!(!rig.is_to_restart, "it was called off for good");
    rig.text(UPDATE);
    for _ in 0..20 {
        rig.widths(&[(1, 1500)]);
        rig.run(20);
    }
    assert!(rig.is_to_restart, "commanded, and disarmed");
}

/// At each start of ArduPilot, and at its safety switch.
#[cfg(feature = "safety")]
#[test]
fn the_monitor_says_why_commands_are_refused_and_when_that_is_over() {
    const SAFETY_STATE: u32 = 0x184E_200A;
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

/// ArduPilot does not arm with a node that is not OPERATIONAL.
#[cfg(feature = "update")]
#[test]
fn the_status_says_software_update_between_the_answer_and_the_restart_and_not_if_it_is_called_off()
{
    const SOFTWARE_UPDATE: u8 = 3 << 3;
    const UPDATE: &str = "1E28F8FF 00 66 77 2E 62 69 6E C9";
    for after_ms in [1, 100, 499, 999] {
        let mut rig = hub();
        rig.program.node.update.start(true);
        rig.run(2000 + after_ms);
        rig.can.sent.clear();
        let asked_ms = rig.ms;
        rig.text(UPDATE);
        while !rig.is_to_restart {
            rig.run(1);
        }
        let frames: Vec<_> =
            rig.can.sent.iter().map(|(ms, frame)| (*ms, golden::id(frame))).collect();
        let answered = frames.iter().position(|(_, id)| *id == 0x1E28_7FF8).unwrap();
        let said = frames.iter().position(|(_, id)| *id == NODE_STATUS).unwrap();
        assert!(said > answered && frames[said].0 - asked_ms < 10, "{frames:?}");
        assert_eq!(rig.can.sent[said].1.data()[4] & 0x38, SOFTWARE_UPDATE);
        assert!(rig.ms - asked_ms >= 100);
    }
    let mut rig = hub();
    rig.program.node.update.start(true);
    rig.text(UPDATE);
    rig.arm(255);
    rig.run(1000);
    assert_eq!(rig.status().0 & 0x38, 0, "called off");
}

#[cfg(feature = "log")]
#[test]
fn a_failsafe_is_told_when_it_begins_and_ends_and_not_more_than_twice_a_second() {
    let mut rig = hub();
    rig.widths(&[(1, 1500)]);
    rig.run(2000);
    rig.widths(&[(1, 1500)]);
    rig.run(900);
    let told = rig.transfers(LOG_MESSAGE, golden::LOG_MESSAGE);
    let texts: Vec<_> = told
        .iter()
        .map(|(_, payload, _)| (payload[0] >> 5, std::str::from_utf8(&payload[1..]).unwrap()))
        .collect();
    assert_eq!(
        texts,
        [
            (2, "FAILSAFE: no commands"),
            (2, "FAILSAFE of output 1"),
            (1, "over: FAILSAFE: no commands")
        ]
    );
    for pair in told.windows(2) {
        assert!(pair[1].0 - pair[0].0 >= 495, "{told:?}");
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
fn notice(rig: &mut Rig, event: mcp2515_ordered::Event, value: u8) {
    rig.program.node.notice(Notice { event, value });
}

/// Causes a condition, or ends its cause. One that passes has no end of its cause.
#[cfg(feature = "log")]
fn cause(rig: &mut Rig, condition: Conditions, on: bool) {
    match condition {
        Conditions::ID_CONFLICT if on => {
            rig.hear(&golden::frame(NODE_STATUS, &[0, 0, 0, 0, 0, 0, 0, 0xC0]));
        }
        Conditions::FRAMES_LOST if on => notice(rig, mcp2515_ordered::Event::Flags, 1 << 7),
        Conditions::ERROR_PASSIVE => notice(rig, mcp2515_ordered::Event::Flags, u8::from(on) << 4),
        Conditions::BUS_OFF if on => notice(rig, mcp2515_ordered::Event::Flags, 1 << 5),
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
        (mcp2515_ordered::Event::NotKeeping, "SI SO SCK? register 43"),
        (mcp2515_ordered::Event::NotStarting, "CAN H/L: never idle (43)"),
        (mcp2515_ordered::Event::Lost, "5V? MCP2515 settings lost"),
        (mcp2515_ordered::Event::IntWrong, "INT open or shorted"),
        (mcp2515_ordered::Event::AnotherRate, "another bit rate or crystal"),
        (mcp2515_ordered::Event::GaveUpSending, "CAN H/L: not sent (1)"),
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

/// And no others, although the status code has them.
#[cfg(feature = "log")]
#[test]
fn conditions_that_are_set_are_told_again_when_the_node_is_error_active_again() {
    let mut rig = Rig::new();
    rig.run(1500);
    for event in [1 << 5, 1 << 4] {
        notice(&mut rig, mcp2515_ordered::Event::Flags, event);
    }
    rig.program.node.record.health.happened(Conditions::TRANSFER_ERRORS);
    rig.run(2000);
    rig.can.sent.clear();
    notice(&mut rig, mcp2515_ordered::Event::Flags, 0);
    rig.run(3000);
    let texts = [(2, "CAN H/L: bus-off"), (1, "over: CAN H/L: error-passive")];
    assert_eq!(told(&rig), texts.map(|(level, text)| (level, text.to_string())));
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
    assert_eq!((rig.code(), rig.level()), (DISARMED, Level::Ok as u8));
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
    let text = |(_, payload, _): (u32, Vec<u8>, u8)| String::from_utf8_lossy(&payload[1..]).into();
    let told: Vec<String> =
        rig.transfers(LOG_MESSAGE, golden::LOG_MESSAGE).into_iter().map(text).collect();
    assert_eq!(told, ["FAILSAFE: no commands", "FAILSAFE of output 138", "FAILSAFE of output 18"]);
}

#[test]
fn a_lost_frame_is_no_warning_while_each_output_gets_its_next_command_within_50_ms() {
    let lost = Notice { event: mcp2515_ordered::Event::Flags, value: 1 << 7 };
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

/// A parachute would open.
#[test]
fn a_restart_moves_no_output_that_follows_no_command() {
    let mut rig = hub();
    for output in 0..8 {
        rig.set_output(output, OutputParameter::Fs, 2);
        rig.set_output(output, OutputParameter::FsPwm, 1900);
    }
    rig.widths(&[(3, 1200)]);
    rig.text(RESTART);
    rig.run(20);
    assert_eq!(rig.servos_us(), [0, 0, 1900, 0, 0, 0, 0, 0]);
}

#[test]
fn a_new_type_or_id_ends_the_pulse_and_is_refused_while_armed() {
    let mut rig = with_motors();
    rig.widths(&[(1, 1900), (2, 1800)]);
    rig.set_output(0, OutputParameter::Type, 1);
    rig.set_output(1, OutputParameter::Id, 20);
    rig.run(20);
    assert_eq!(rig.servos_us()[..2], [0, 0]);
    for (name, value) in [("OUT7_TYPE", 0), ("OUT8_ID", 9), ("OUT_COUNT", 1)] {
        rig.arm(255);
        rig.throttles(FULL_AND_HALF);
        rig.get_set(&set(0, value, name));
        rig.throttles(FULL_AND_HALF);
        assert_eq!(rig.servos_us()[6..], [2000, 1500], "{name}");
    }
    let parameters = &rig.program.node.parameters;
    assert_eq!(parameters.of(6, OutputParameter::Type), 1);
    assert_eq!(parameters.of(7, OutputParameter::Id), 1);
    assert_eq!(parameters.get(Parameter::OutCount), 8);
}

/// Neither the list's entry for the old ID nor, in the place of the new one, that of a list before,
/// which was not complete.
#[test]
fn an_output_that_gets_another_id_in_the_middle_of_a_list_follows_nothing_before() {
    let mut rig = hub();
    let incomplete = widths(&[(7, 1900), (1, 1500), (2, 1500)]);
    rig.hear(&incomplete[0]);
    let frames = widths(&[(8, 1200), (1, 1500), (2, 1600)]);
    rig.hear(&frames[0]);
    rig.set_output(7, OutputParameter::Id, 7);
    frames[1..].iter().for_each(|frame| rig.hear(frame));
    rig.run(20);
    assert_eq!(rig.servos_us(), [1500, 1600, 0, 0, 0, 0, 0, 0]);
    rig.widths(&[(7, 1700), (8, 1100)]);
    assert_eq!(rig.servos_us()[6..], [1700, 1700]);
}

/// What was to be resumed, or was missed, was for the old ID.
#[cfg(feature = "safety")]
#[test]
fn an_output_with_another_id_has_no_failsafe_before_a_command_for_it() {
    const SAFETY_STATE: u32 = 0x184E_200A;
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

#[cfg(feature = "safety")]
#[test]
fn the_safety_switch_stops_motors_with_the_minimum_and_ends_the_pulses_of_servos() {
    let mut rig = with_motors();
    rig.set(Parameter::SafeMode, 1);
    rig.arm(255);
    rig.widths(&[(1, 1900)]);
    rig.throttles(FULL_AND_HALF);
    let now_ms = rig.now_ms();
    let Node { control, parameters, .. } = &mut rig.program.node;
    control.outputs.act_on_safety_state(10, 0, now_ms, parameters);
    rig.run(20);
    assert_eq!(rig.servos_us(), [0, 0, 0, 0, 0, 0, 1000, 1000]);
}

#[test]
fn a_raw_command_that_is_too_short_or_for_others_is_no_command() {
    let mut rig = with_motors();
    rig.arm(255);
    let followed = rig.program.node.health().counts.followed;
    rig.throttles("");
    rig.throttles("FF");
    assert_eq!(rig.program.node.health().counts.followed, followed);
    rig.throttles("FF 7C");
    assert_eq!(
        (rig.servos_us()[6..].to_vec(), rig.program.node.health().counts.followed),
        (vec![2000, 0], followed + 1)
    );
}

#[test]
fn a_single_motor_lets_raw_commands_through_the_filters() {
    let mut rig = Rig::with(&[]);
    rig.run(5000);
    assert_eq!(rig.program.node.acceptance(InMemory).row, Row::WITH_ID);
    let set = rig.can.filters_set;
    rig.set_output(0, OutputParameter::Type, 1);
    rig.run(5000);
    assert_eq!(rig.program.node.acceptance(InMemory).row, Row::WITH_MOTORS);
    assert_eq!(rig.can.filters_set, set + 1);
}

#[test]
fn several_outputs_let_all_frames_through_the_filters_and_drop_those_of_others_silently() {
    let mut rig = Rig::with(&[(Parameter::OutCount, 2)]);
    rig.run(5000);
    let set = rig.can.filters_set;
    rig.set_output(1, OutputParameter::Type, 1);
    rig.run(5000);
    assert_eq!(rig.program.node.acceptance(InMemory).row, Row::WITH_SEVERAL_OUTPUTS);
    assert_eq!(rig.can.filters_set, set);
    let refused = rig.program.node.health().counts.refused;
    // esc.Status, a request and a response of others, a request for an ID, a standard frame.
    for id in [0x1804_0A0A, 0x1E0B_8AFF, 0x1E0B_7F8A, 0x1E97_4D00, 0x8000_0000] {
        rig.hear(&golden::frame(id, &[1, 2, 3, 0xC0]));
    }
    assert_eq!(rig.program.node.health().counts.refused, refused);
    // From this node's ID.
    rig.hear(&golden::frame(0x1804_0A00 | u32::from(rig.program.node.id()), &[0xC0]));
    assert_eq!(rig.program.node.health().counts.refused, refused + 1);
}
