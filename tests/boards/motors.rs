//! Outputs that are motors (OUTn_TYPE 1): they follow esc.RawCommand by index, only while the
//! vehicle is armed, and stop when commands do.

use bench::dronecan::esc::encode_commands;
use bench::dronecan::{TransferId, Value, split, types};
use rig::load::{Client, Kind, Load, Loaded, Pace, SENDER};
use rig::status::{ERROR, FAILSAFE, OK};
use rig::{ARMED, ARMING_STATUS, ARRAY_COMMAND, PWM, Program, RAW_COMMAND, Rig};

const PROGRAM: Program = Program::Full;

/// A node whose outputs 1 to 4 are servos, and 5 to 8 motors with the indices 0 to 3.
fn node() -> Rig {
    PROGRAM.running_set(&[
        ("OUT_COUNT", 8),
        ("OUT5_TYPE", 1),
        ("OUT5_ID", 0),
        ("OUT6_TYPE", 1),
        ("OUT6_ID", 1),
        ("OUT7_TYPE", 1),
        ("OUT7_ID", 2),
        ("OUT8_TYPE", 1),
        ("OUT8_ID", 3),
    ])
}

fn motors_us(rig: &mut Rig) -> [Option<f64>; 4] {
    rig.widths_us()[4..].try_into().expect("four")
}

/// The receiver of ArrayCommand looks up the output of an entry, and must not find a motor.
#[test]
fn an_entry_with_the_id_of_a_servo_that_became_a_motor_leaves_the_others_alone() {
    let mut rig = node();
    rig.send_commands(&[(1, PWM, 1200.0), (2, PWM, 1300.0)]);
    rig.run_ms(25);
    rig.set("OUT2_TYPE", 1);
    rig.run_ms(25);
    rig.send_commands(&[(1, PWM, 1400.0), (2, PWM, 1500.0), (3, PWM, 1600.0)]);
    assert_eq!(rig.widths_us()[..3], [Some(1400.0), None, Some(1600.0)]);
}

#[test]
fn motors_follow_raw_commands_by_index_while_the_vehicle_is_armed() {
    let mut rig = node();
    rig.arm(ARMED);
    assert_eq!(rig.widths_us(), [None; 8], "no pulse before the first command");
    rig.send_raw_command(SENDER, &[8191, 4096, 0, -8192]);
    assert_eq!(
        rig.widths_us(),
        [None, None, None, None, Some(2000.0), Some(1500.0), Some(1000.0), Some(1000.0)]
    );
    // The command has eight frames; the node keeps the part that eighteen motors need.
    rig.send_raw_command(SENDER, &[2048; 20]);
    assert_eq!(motors_us(&mut rig), [Some(1250.0); 4]);
    // A shorter command stops the other motors.
    rig.send_raw_command(SENDER, &[8191]);
    assert_eq!(motors_us(&mut rig), [Some(2000.0), Some(1000.0), Some(1000.0), Some(1000.0)]);
}

#[test]
fn each_kind_of_command_moves_only_outputs_of_its_kind() {
    let mut rig = node();
    rig.arm(ARMED);
    let all: Vec<_> = (0..15).map(|id| (id, PWM, 1700.0)).collect();
    rig.send_commands(&all);
    let servos = [Some(1700.0); 4];
    assert_eq!(rig.widths_us(), [&servos[..], &[None; 4]].concat());
    rig.send_raw_command(SENDER, &[4096; 8]);
    assert_eq!(rig.widths_us(), [&servos[..], &[Some(1500.0); 4]].concat());
}

/// A sender that sorts its frames by identifier interleaves both kinds of command.
#[test]
fn an_array_command_between_the_frames_of_a_raw_command_breaks_neither() {
    let mut rig = node();
    rig.arm(ARMED);
    let seed = types::RAW_COMMAND.seed.expect("known");
    let ours = split(&encode_commands(&[4096; 8]), TransferId::new(3), seed);
    let others = rig::array_command(&(1..=8).map(|id| (id, PWM, 1300.0)).collect::<Vec<_>>(), 9);
    assert!(ours.len() > 2 && others.len() > ours.len());
    for (n, theirs) in others.iter().enumerate() {
        if let Some(data) = ours.get(n) {
            rig.send(RAW_COMMAND | SENDER, data);
        }
        rig.send(ARRAY_COMMAND | SENDER, theirs);
    }
    assert_eq!(rig.widths_us(), [[Some(1300.0); 4], [Some(1500.0); 4]].concat());
    assert_eq!(rig.status_now(), (OK, 0));
}

#[test]
fn a_motor_stops_at_disarming_and_ignores_commands() {
    let mut rig = node();
    assert_eq!(motors_us(&mut rig), [None; 4], "it was never commanded");
    rig.send_raw_command(SENDER, &[4096; 4]);
    assert_eq!(motors_us(&mut rig), [Some(1000.0); 4], "the vehicle was never armed");
    rig.wait_for_line("refused: command from 10 tid 0, disarmed (ArmingStatus)", 50);
    rig.arm(ARMED);
    rig.send_raw_command(SENDER, &[4096; 4]);
    assert_eq!(motors_us(&mut rig), [Some(1500.0); 4]);
    rig.arm(0);
    assert_eq!(motors_us(&mut rig), [Some(1000.0); 4]);
    rig.send_raw_command(SENDER, &[8191; 4]);
    assert_eq!(motors_us(&mut rig), [Some(1000.0); 4]);
}

#[test]
fn without_arming_statuses_the_vehicle_counts_as_disarmed_after_four_to_five_seconds() {
    let mut rig = node();
    rig.arm(ARMED);
    for ms in (0..5200).step_by(50) {
        rig.send_raw_command(SENDER, &[4096; 4]);
        rig.run_ms(50);
        if ms == 3800 {
            assert_eq!(rig.status_now(), (OK, 0));
            assert!(!rig.serial.contains("disarmed"), "{}", rig.serial);
        }
    }
    assert_eq!(motors_us(&mut rig), [Some(1000.0); 4]);
}

/// OUTn_FS and OUTn_TIMEOUT are for servos.
#[test]
fn a_motor_stops_when_its_commands_stop_and_the_other_outputs_continue() {
    let mut rig = node();
    rig.set_all(&[("OUT5_TIMEOUT", 200), ("OUT6_TIMEOUT", 0), ("OUT5_FS", 0), ("OUT6_FS", 3)]);
    rig.arm(ARMED);
    rig.send_commands(&[(1, PWM, 1600.0)]);
    rig.send_raw_command(SENDER, &[4096, 4096, 4096]);
    rig.run_ms(100);
    assert_eq!(motors_us(&mut rig), [Some(1500.0), Some(1500.0), Some(1500.0), None]);
    rig.run_ms(200);
    assert_eq!(motors_us(&mut rig), [Some(1000.0), Some(1000.0), Some(1000.0), None]);
    assert_eq!(rig.status_now().1 & FAILSAFE, 0, "it may have disarmed");
    rig.arm(ARMED);
    rig.run_ms(10);
    assert_eq!(rig.next_status(), (ERROR, FAILSAFE));
    assert!(rig.serial.contains("FAILSAFE of output 567"), "{}", rig.serial);
    let widths = rig.widths_us();
    assert_eq!(widths[..4], [Some(1600.0), None, None, None]);
    assert_eq!(widths[4..], [Some(1000.0), Some(1000.0), Some(1000.0), None]);
}

#[test]
fn while_the_safety_switch_is_on_motors_stop_and_servos_may_hold() {
    let mut rig = node();
    rig.set("SAFE_MODE", 0);
    rig.arm(ARMED);
    rig.send_commands(&[(1, PWM, 1600.0)]);
    rig.send_raw_command(SENDER, &[4096; 4]);
    rig.run_ms(50);
    rig.send(0x104E_200A, &[0, 0xC0]);
    let widths = rig.widths_us();
    assert_eq!(widths[0], Some(1600.0));
    assert_eq!(widths[4..], [Some(1000.0); 4]);
    rig.send_raw_command(SENDER, &[8191; 4]);
    assert_eq!(motors_us(&mut rig), [Some(1000.0); 4]);
}

#[test]
fn an_output_whose_type_changes_ignores_its_old_commands() {
    let mut rig = node();
    rig.arm(ARMED);
    rig.send_commands(&[(1, PWM, 1600.0), (2, PWM, 1600.0)]);
    rig.run_ms(50);
    // While armed a motor could stop.
    assert_eq!(rig.request_value("OUT1_TYPE", Value::Integer(1)), Value::Integer(0));
    rig.arm(0);
    rig.set("OUT1_TYPE", 1);
    rig.send_commands(&[(1, PWM, 1900.0), (2, PWM, 1900.0)]);
    rig.send_servo_command(255);
    assert_eq!(rig.widths_us()[..2], [None, Some(1900.0)]);
    rig.arm(ARMED);
    // OUTn_ID becomes the motor's index.
    rig.send_raw_command(SENDER, &[0, 8191]);
    assert_eq!(rig.widths_us()[..2], [Some(2000.0), Some(1900.0)]);
}

/// Autopilots send 50 to 1000 a second.
#[test]
fn of_2000_raw_commands_for_eight_motors_a_second_no_frame_is_lost() {
    let load = Load { kind: Kind::RawCommand, priority: 31, pace: Pace::Every(16_000_000 / 6000) };
    let mut loaded = Loaded::with_rig(node(), Some(load), Client::Walking);
    for _ in 0..8 {
        loaded.rig.send(ARMING_STATUS | SENDER, &[ARMED, 0xC0]);
        loaded.run_ms(250);
    }
    assert_eq!(
        loaded.rig.board().take_output_pulses()[4..]
            .iter()
            .filter(|pulses| pulses.len() > 90)
            .count(),
        3
    );
    let figures = loaded.finish();
    let meter = &figures.meter;
    println!("{} frames, release at most {} cycles", meter.frames, meter.latency.max());
    assert_eq!((meter.lost, meter.garbled, figures.stuck), (0, 0, false));
    assert!(meter.latency.max() <= 1600, "{} cycles", meter.latency.max());
}

#[test]
fn the_node_s_servos_have_an_actuator_status_and_its_motors_none() {
    let mut rig = node();
    rig.forget();
    rig.run_ms(2000);
    let ids: std::collections::BTreeSet<u8> = rig
        .node_messages(|message| match message {
            bench::dronecan::Message::ActuatorStatus(status) => Some(status.actuator),
            _ => None,
        })
        .into_iter()
        .map(|(_, id)| id)
        .collect();
    assert_eq!(ids.into_iter().collect::<Vec<_>>(), [1, 2, 3, 4]);
}
