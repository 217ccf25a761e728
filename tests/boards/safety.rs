//! ArduPilot's safety switch (SafetyState): while it is on, missing commands are no error. For
//! firmwares with the feature `safety`.

use rig::status::{DISARMED, ERROR, FAILSAFE, OK};
use rig::{ARMED, MS, Program, Rig, SAFE, SAFETY_STATE};

const PROGRAM: Program = Program::Full;

/// Sends a SafetyState twice a second, like ArduPilot.
fn send_safety_state(rig: &mut Rig, state: u8, ms: u64) {
    let end = rig.now() + ms * MS;
    while rig.now() < end {
        rig.send(SAFETY_STATE | 10, &[state, 0xC0]);
        rig.run_until(end.min(rig.now() + 500 * MS));
    }
}

#[test]
fn while_the_safety_switch_is_on_there_are_no_pulses_and_the_node_is_ok() {
    let mut rig = PROGRAM.positioned();
    send_safety_state(&mut rig, SAFE, 100);
    rig.forget();
    send_safety_state(&mut rig, SAFE, 5000);
    assert_eq!(rig.pulses, []);
    assert_eq!(rig.next_status(), (OK, DISARMED));
    assert!(!rig.serial.contains("FAILSAFE"), "{}", rig.serial);
    // A command must not start the pulses.
    rig.send_command(1, 0, 0.0);
    rig.wait_for_line("refused: command from 10 tid 1, safety switch on", 50);
    rig.run_ms(100);
    assert_eq!(rig.pulses, []);
}

#[test]
fn with_safe_mode_0_the_servo_holds_its_position() {
    let mut rig = PROGRAM.positioned();
    rig.set("SAFE_MODE", 0);
    send_safety_state(&mut rig, SAFE, 100);
    rig.wait_for_line("safety switch on", 50);
    rig.forget();
    send_safety_state(&mut rig, SAFE, 5000);
    assert!(rig.pulses.len() > 200 && rig.pulses.iter().all(|pulse| pulse.width_us() == 1750.0));
    assert_eq!(rig.next_status(), (OK, DISARMED));
    rig.send_command(1, 0, 0.0);
    assert_eq!(rig.settled_pulse_us(), 1750.0);
}

#[test]
fn when_the_switch_is_off_commands_are_followed_and_the_failsafe_is_active_again() {
    let mut rig = PROGRAM.positioned();
    send_safety_state(&mut rig, SAFE, 3000);
    send_safety_state(&mut rig, ARMED, 1);
    rig.send_command(1, 0, -0.5);
    assert_eq!(rig.settled_pulse_us(), 1250.0);
    assert_eq!(rig.next_status().1 & DISARMED, 0);
    send_safety_state(&mut rig, SAFE, 3000);
    send_safety_state(&mut rig, ARMED, 1);
    rig.wait_for_line("FAILSAFE: no commands", 1100);
    assert_eq!(rig.next_status(), (ERROR, FAILSAFE));
}

/// The autopilot stops sending SafetyState.
#[test]
fn when_the_safety_states_stop_the_failsafe_begins() {
    let mut rig = PROGRAM.positioned();
    send_safety_state(&mut rig, SAFE, 2000);
    rig.run_ms(2500);
    assert!(!rig.serial.contains("switch off"), "four seconds after the last: {}", rig.serial);
    rig.wait_for_line("FAILSAFE: no commands", 3500);
    assert_eq!(rig.next_status(), (ERROR, FAILSAFE));
}

#[test]
fn the_switch_ends_the_failsafe_which_begins_again_after_it() {
    let mut rig = PROGRAM.positioned();
    rig.wait_for_line("FAILSAFE: no commands", 1100);
    send_safety_state(&mut rig, SAFE, 1500);
    assert_eq!(rig.next_status(), (OK, DISARMED));
    send_safety_state(&mut rig, ARMED, 1);
    rig.wait_for_line("FAILSAFE: no commands", 1100);
}

#[test]
fn without_commands_or_safety_states_the_failsafe_is_unchanged() {
    let mut rig = PROGRAM.running();
    send_safety_state(&mut rig, SAFE, 1500);
    assert_eq!(rig.next_status(), (OK, DISARMED));
    send_safety_state(&mut rig, ARMED, 3000);
    assert_eq!((rig.next_status(), &rig.pulses[..]), ((OK, 0), &[][..]));
    let mut rig = PROGRAM.positioned();
    rig.wait_for_line("FAILSAFE: no commands", 1100);
    assert!(!rig.serial.contains("safety"));
}

#[test]
fn another_node_s_safety_state_is_rejected() {
    let mut rig = PROGRAM.positioned();
    rig.send(SAFETY_STATE | 11, &[SAFE, 0xC0]);
    rig.wait_for_line("refused: type 20000 from 11, wrong sender", 50);
    rig.send_command(1, 0, 0.0);
    assert_eq!(rig.settled_pulse_us(), 1500.0);
}
