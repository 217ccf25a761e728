//! The servo follows commands exactly, and ignores everything else.

use std::f32::consts::FRAC_PI_4;

use rig::{ARRAY_COMMAND, MS, POSITION, PWM, Rig, UNITLESS, node_ms};

const FORCE: u8 = 2;
const SPEED: u8 = 3;

/// pydronecan's ArrayCommand(1, UNITLESS, 0.5) from node 10.
#[test]
fn a_golden_command_moves_the_servo() {
    let mut rig = Rig::running();
    rig.send(0x1003_F20A, &[0x01, 0x00, 0x00, 0x38, 0xC7]);
    assert_eq!(rig.settled_pulse_us(), 1750.0);
}

#[test]
fn there_is_no_pulse_before_the_first_command() {
    let mut rig = Rig::powered();
    rig.run_ms(2000);
    assert_eq!(rig.pulses, []);
    rig.send_command(1, UNITLESS, 0.0);
    assert_eq!(rig.settled_pulse_us(), 1500.0);
    assert!(
        rig.pulses.iter().all(|pulse| pulse.width_us() == 1500.0),
        "the first pulse must be complete: {:?}",
        rig.pulses
    );
}

#[test]
fn each_command_type_moves_the_servo_in_its_own_unit() {
    let mut rig = Rig::running();
    for (command_type, value, pulse_us) in [
        (UNITLESS, -1.0, 1000.0),
        (UNITLESS, 1.0, 2000.0),
        (UNITLESS, -0.25, 1375.0),
        (POSITION, 0.0, 1500.0),
        (POSITION, FRAC_PI_4, 2000.0),
        (POSITION, -FRAC_PI_4, 1000.0),
        (PWM, 1234.0, 1234.0),
        (PWM, 1001.0, 1001.0),
        (PWM, 2000.0, 2000.0),
    ] {
        rig.send_command(1, command_type, value);
        assert_eq!(rig.settled_pulse_us(), pulse_us, "type {command_type}, value {value}");
    }
}

#[test]
fn an_invalid_command_does_not_move_the_servo() {
    let mut rig = Rig::running();
    rig.send_command(1, UNITLESS, 0.5);
    assert_eq!(rig.settled_pulse_us(), 1750.0);
    let refused = [
        (UNITLESS, f32::NAN),
        (UNITLESS, f32::INFINITY),
        (UNITLESS, f32::NEG_INFINITY),
        (POSITION, f32::NAN),
        (PWM, f32::INFINITY),
        (PWM, 0.0),
        (PWM, -1500.0),
        (FORCE, 0.0),
        (SPEED, 0.0),
        (5, 0.0),
        (255, 0.0),
    ];
    for (command_type, value) in refused {
        rig.send_command(1, command_type, value);
        assert_eq!(rig.settled_pulse_us(), 1750.0, "type {command_type}, value {value}");
    }
    rig.run_ms(200);
    assert_eq!(
        rig.serial.matches("refused: command from 10").count(),
        refused.len(),
        "{}",
        rig.serial
    );
    rig.board().avr_mut().serial_send(b"?");
    rig.wait_for_line(&format!("commands followed 1, frames refused {}", refused.len()), 100);
}

#[test]
fn commands_for_other_actuators_do_not_move_the_servo() {
    let mut rig = Rig::running();
    rig.send_command(1, UNITLESS, 0.5);
    rig.settled_pulse_us();
    for actuator_id in [0, 2, 3, 15, 255] {
        rig.send_command(actuator_id, UNITLESS, -1.0);
        assert_eq!(rig.settled_pulse_us(), 1750.0, "actuator {actuator_id}");
    }
    rig.send(ARRAY_COMMAND | 10, &[0xC0]);
    assert_eq!(rig.settled_pulse_us(), 1750.0, "an empty command");
    rig.board().avr_mut().serial_send(b"?");
    rig.wait_for_line("commands followed 1, frames refused 0", 100);
}

#[test]
fn a_new_width_begins_with_a_period_whenever_the_command_comes() {
    let mut rig = Rig::running();
    rig.send_command(1, PWM, 2000.0);
    rig.settled_pulse_us();
    rig.forget();
    // Commands at all phases of the period, also during a pulse: every pulse has one of the two
    // widths.
    for step in 0..200u64 {
        let width = if step % 2 == 0 { 1000.0 } else { 2000.0 };
        rig.send_command(1, PWM, width);
        let t = rig.now() + 20 * MS + 1_600 * (step % 13);
        rig.run_until(t);
    }
    assert!(rig.pulses.len() > 190);
    for pulse in &rig.pulses {
        assert!([1000.0, 2000.0].contains(&pulse.width_us()), "{pulse:?}");
        assert_eq!(pulse.period_cycles.unwrap_or(20 * MS), 20 * MS);
    }
}

#[test]
fn a_thousand_commands_at_50_hz_give_a_thousand_correct_pulses() {
    let mut rig = Rig::running();
    rig.send_command(1, PWM, 1500.0);
    rig.run_ms(50);
    // Runs to the middle of the pause between two pulses.
    let last = *rig.pulses.last().unwrap();
    rig.run_until(last.start + 10 * MS + 20 * MS);
    rig.forget();
    for n in 0..1000u16 {
        rig.send_command(1, PWM, f32::from(1000 + n));
        let t = rig.now() + node_ms(20);
        rig.run_until(t);
    }
    assert_eq!(rig.pulses.len(), 1000);
    for (n, pulse) in rig.pulses.iter().enumerate() {
        assert_eq!(pulse.width_us(), 1000.0 + n as f64);
    }
}
