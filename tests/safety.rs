//! ArduPilot's safety switch, by SafetyState: while it is on, missing commands are no error. In the build with the feature `safety`.

use rig::status::{DISARMED, ERROR, FAILSAFE, OK};
use rig::{MS, Rig};

/// ardupilot.indication.SafetyState of node 10.
const SAFETY_STATE: u32 = 0x104E_200A;
const SAFE: u8 = 0;
const ARMED: u8 = 255;

/// Twice a second, as ArduPilot sends it.
fn tell(rig: &mut Rig, state: u8, ms: u64) {
    let end = rig.now() + ms * MS;
    while rig.now() < end {
        rig.send(SAFETY_STATE, &[state, 0xC0]);
        rig.run_until(end.min(rig.now() + 500 * MS));
    }
}

#[test]
fn while_the_safety_switch_is_on_there_are_no_pulses_and_the_node_is_ok_and_says_why() {
    let mut rig = Rig::positioned();
    tell(&mut rig, SAFE, 100);
    rig.forget();
    tell(&mut rig, SAFE, 5000);
    assert_eq!(rig.pulses, []);
    assert_eq!(rig.next_status(), (OK, DISARMED));
    assert!(!rig.serial.contains("FAILSAFE"), "{}", rig.serial);
    // A command does not move it.
    rig.send_command(1, 0, 0.0);
    rig.wait_for_line("refused: command from 10 tid 1, safety switch on", 50);
    rig.run_ms(100);
    assert_eq!(rig.pulses, []);
}

#[test]
fn with_safe_mode_0_the_pulse_is_held() {
    let mut rig = Rig::positioned();
    rig.set("SAFE_MODE", 0);
    tell(&mut rig, SAFE, 100);
    rig.wait_for_line("safety switch on", 50);
    rig.forget();
    tell(&mut rig, SAFE, 5000);
    assert!(rig.pulses.len() > 200 && rig.pulses.iter().all(|pulse| pulse.width_us() == 1750.0));
    assert_eq!(rig.next_status(), (OK, DISARMED));
    rig.send_command(1, 0, 0.0);
    assert_eq!(rig.settled_pulse_us(), 1750.0);
}

#[test]
fn when_the_switch_is_off_commands_are_followed_at_once_and_missed_again() {
    let mut rig = Rig::positioned();
    tell(&mut rig, SAFE, 3000);
    tell(&mut rig, ARMED, 1);
    rig.send_command(1, 0, -0.5);
    assert_eq!(rig.settled_pulse_us(), 1250.0);
    assert_eq!(rig.next_status().1 & DISARMED, 0);
    tell(&mut rig, SAFE, 3000);
    tell(&mut rig, ARMED, 1);
    rig.wait_for_line("FAILSAFE: no commands", 1100);
    assert_eq!(rig.next_status(), (ERROR, FAILSAFE));
}

/// The autopilot has stopped.
#[test]
fn when_safety_states_stop_the_failsafe_begins() {
    let mut rig = Rig::positioned();
    tell(&mut rig, SAFE, 2000);
    rig.run_ms(2000);
    assert!(!rig.serial.contains("FAILSAFE"));
    rig.wait_for_line("FAILSAFE: no commands", 3500);
    assert_eq!(rig.next_status(), (ERROR, FAILSAFE));
}

#[test]
fn a_failsafe_that_the_switch_explains_is_over_and_comes_back_after_it() {
    let mut rig = Rig::positioned();
    rig.wait_for_line("FAILSAFE: no commands", 1100);
    tell(&mut rig, SAFE, 1500);
    assert_eq!(rig.next_status(), (OK, DISARMED));
    tell(&mut rig, ARMED, 1);
    rig.wait_for_line("FAILSAFE: no commands", 1100);
}

#[test]
fn before_the_first_command_and_without_safety_states_nothing_changes() {
    let mut rig = Rig::running();
    tell(&mut rig, SAFE, 1500);
    assert_eq!(rig.next_status(), (OK, DISARMED));
    tell(&mut rig, ARMED, 3000);
    assert_eq!((rig.next_status(), &rig.pulses[..]), ((OK, 0), &[][..]));
    let mut rig = Rig::positioned();
    rig.wait_for_line("FAILSAFE: no commands", 1100);
    assert!(!rig.serial.contains("safety"));
}

#[test]
fn another_node_s_safety_state_is_refused() {
    let mut rig = Rig::positioned();
    rig.send(SAFETY_STATE + 1, &[SAFE, 0xC0]);
    rig.wait_for_line("refused: type 20000 from 11, wrong sender", 50);
    rig.send_command(1, 0, 0.0);
    assert_eq!(rig.settled_pulse_us(), 1500.0);
}
