//! Two nodes that command the same output, and which node may arm.

use bench::can::Frame;
use rig::status::{DISARMED, OK, TWO_COMMANDERS, WARNING};
use rig::{ARMING_STATUS, ARRAY_COMMAND, MS, NODE_STATUS, Rig, array_command};

const PWM: u8 = 4;

/// A command in one frame from node `source`.
fn command_from(rig: &mut Rig, source: u32, actuator: u8, value: f32) {
    let frames = array_command(&[(actuator, 0, value)], 0);
    assert_eq!(frames.len(), 1);
    rig.send_frame(Frame::extended(ARRAY_COMMAND | source, &frames[0]));
}

/// Each of these nodes sends 50 commands a second, half a period apart.
fn command_together(rig: &mut Rig, sources: &[(u32, u8)], ms: u64) {
    let end = rig.now() + ms * MS;
    while rig.now() < end {
        for &(source, actuator) in sources {
            command_from(rig, source, actuator, 0.5);
            rig.run_until(rig.now() + 20 * MS / sources.len() as u64);
        }
    }
}

#[test]
fn two_commanders_are_a_warning_until_ten_seconds_after_the_last_conflict() {
    let mut rig = Rig::running();
    command_together(&mut rig, &[(10, 1)], 3000);
    assert_eq!(rig.next_status(), (OK, 0));
    command_together(&mut rig, &[(10, 1), (11, 1)], 2000);
    assert_eq!(rig.next_status(), (WARNING, TWO_COMMANDERS));
    assert_eq!(rig.serial.matches("TWO COMMANDERS").count(), 1, "{}", rig.serial);
    command_together(&mut rig, &[(10, 1)], 13_000);
    assert_eq!(rig.next_status(), (OK, 0));
}

#[test]
fn a_node_that_commands_other_outputs_is_no_second_commander() {
    let mut rig = Rig::running();
    command_together(&mut rig, &[(10, 1), (11, 2)], 3000);
    assert_eq!(rig.next_status(), (OK, 0));
}

/// A tool sends commands first, then the autopilot.
#[test]
fn after_a_commander_stops_another_takes_over_without_a_warning() {
    let mut rig = Rig::running();
    for source in [10, 11, 10] {
        command_together(&mut rig, &[(source, 1)], 1000);
        // Longer than the two seconds in which a command counts as recent. The tool continues to
        // send its status.
        for _ in 0..5 {
            rig.send(NODE_STATUS | source, &[0, 0, 0, 0, 0, 0, 0, 0xC0]);
            rig.run_ms(500);
        }
        assert_eq!(rig.next_status().1 & TWO_COMMANDERS, 0);
    }
}

fn is_disarmed(rig: &mut Rig) -> bool {
    rig.next_status().1 & DISARMED != 0
}

#[test]
fn only_the_commander_arms_and_disarms() {
    let mut rig = Rig::running();
    rig.set("ARM_REQ", 1);
    command_together(&mut rig, &[(10, 1)], 100);
    assert!(is_disarmed(&mut rig));
    for (source, armed, is_disarmed_then) in
        [(11, 255, true), (10, 255, false), (11, 0, false), (10, 0, true)]
    {
        rig.send(ARMING_STATUS | source, &[armed, 0xC0]);
        rig.run_ms(10);
        let logged = format!("refused: type 1100 from {source}, wrong sender");
        assert_eq!(rig.serial.contains(&logged), source == 11, "{}", rig.serial);
        // A command makes its sender the commander for longer.
        command_together(&mut rig, &[(10, 1)], 1000);
        rig.send(ARMING_STATUS | source, &[armed, 0xC0]);
        assert_eq!(is_disarmed(&mut rig), is_disarmed_then, "{armed} of {source}");
        rig.forget();
    }
}

#[test]
fn without_a_commander_the_lowest_node_id_may_arm() {
    let mut rig = Rig::running();
    rig.set("ARM_REQ", 1);
    for source in [20, 10] {
        rig.send(NODE_STATUS | source, &[0, 0, 0, 0, 0, 0, 0, 0xC0]);
    }
    // 255 is fully armed.
    rig.send(ARMING_STATUS | 20, &[255, 0xC0]);
    assert!(is_disarmed(&mut rig));
    rig.send(ARMING_STATUS | 10, &[255, 0xC0]);
    assert!(!is_disarmed(&mut rig));
}

#[test]
fn while_disarmed_a_command_does_not_move_the_servo() {
    let mut rig = Rig::running();
    rig.set("ARM_REQ", 1);
    command_together(&mut rig, &[(10, 1)], 500);
    assert_eq!(rig.pulses, []);
    rig.wait_for_line("refused: command from 10 tid 0, disarmed", 50);
}

/// A node completes a list and begins another just before each list of the commander. With one lane
/// for lists it could keep all of them out.
#[test]
fn a_node_that_begins_a_list_before_each_of_the_commander_s_breaks_at_most_every_other() {
    let mut rig = Rig::running();
    let long_list = |rig: &mut Rig, us, transfer_id| {
        let mut entries = [(2, PWM, 1_500.0); 15];
        entries[0] = (1, PWM, us);
        for data in array_command(&entries, transfer_id) {
            rig.send(ARRAY_COMMAND | 60, &data);
        }
        rig.run_ms(19);
    };
    long_list(&mut rig, 1_100.0, 31);
    let widths = (0..150).map(|n| 1_100.0 + 5.0 * n as f32);
    for (us, transfer_id) in widths.zip((0..32).cycle()) {
        let next_id = (transfer_id + 1) % 32;
        let first = array_command(&[(9, 0, 0.0); 15], next_id).swap_remove(0);
        for data in array_command(&[(9, 0, 0.0); 2], transfer_id).into_iter().chain([first]) {
            rig.send(ARRAY_COMMAND | 10, &data);
        }
        rig.run_ms(1);
        long_list(&mut rig, us, transfer_id);
        // A pulse may have begun before the last list.
        if us >= 1_200.0 {
            let followed_us = rig.pulses.last().expect("a pulse").width_us();
            assert!(followed_us >= f64::from(us) - 16.0, "{followed_us} us after {us}");
        }
    }
}
