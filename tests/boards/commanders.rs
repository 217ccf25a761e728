//! Two nodes that command the same output, and which node may arm.

use bench::can::Frame;
use rig::status::{DISARMED, OK, TWO_COMMANDERS, WARNING};
use rig::{ARMING_STATUS, ARRAY_COMMAND, MS, NODE_STATUS, PWM, Program, Rig, array_command};

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
#[ignore = "takes long: make test-all"]
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

/// Whatever the moment at which a node says so.
#[test]
fn a_commander_that_arms_is_heard_although_another_always_commands_after_it() {
    for program in [Program::Preset, Program::With("full")] {
        let mut rig = program.running();
        rig.set("ARM_REQ", 1);
        for slot in 0..400 {
            for (source, value) in [(10, 0.5), (11, -0.5)] {
                command_from(&mut rig, source, 1, value);
                rig.run_ms(1);
            }
            if slot % 25 == 0 {
                rig.send(ARMING_STATUS | 10, &[255, 0xC0]);
            }
            rig.run_ms(18);
            if slot == 50 {
                rig.pulses.clear();
            }
        }
        assert!(!is_disarmed(&mut rig), "{}", rig.serial);
        assert!(rig.pulses.len() > 300, "{} pulses", rig.pulses.len());
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

/// Each attacker completes a list of this entry and begins another, before each list of the
/// commander and in each gap of it, from the commander's list `from` on. Returns the longest time
/// in milliseconds in which the node does not follow the commander, in the first two seconds and
/// later.
fn waits_ms(attackers: &[u32], entry: (u8, u8, f32), from: u8) -> [u32; 2] {
    let mut rig = Rig::running();
    // Four attackers and the commander send 117 frames: 17 ms at 1 Mbit/s, 33 ms at 500 kbit/s.
    let is_slow = attackers.len() == 4 && rig::board().fastest_bit_rate() < 1_000_000;
    let period_ms = if is_slow { 40 } else { 20 };
    let others = array_command(&[entry; 2], 0);
    let (mut waits_ms, mut waited_ms) = ([0, 0], 0);
    for n in 0..200 {
        let begins = rig.now();
        let us = 1_100.0 + 4.0 * f32::from(n);
        let mut entries = [(2, PWM, 1_500.0); 15];
        entries[0] = (1, PWM, us);
        for own in array_command(&entries, n % 32) {
            for source in attackers.iter().filter(|_| n >= from) {
                for data in [&others[0], &others[1], &others[0]] {
                    rig.send(ARRAY_COMMAND | source, data);
                }
            }
            rig.send(ARRAY_COMMAND | 60, &own);
        }
        rig.run_until(begins + u64::from(period_ms) * MS);
        // The pulse that begins now may have the width of the list before.
        let followed_us = rig.pulses.last().map_or(0.0, |pulse| pulse.width_us());
        waited_ms += period_ms;
        if followed_us >= f64::from(us) - 5.0 {
            waited_ms = 0;
        }
        let wait_ms = &mut waits_ms[usize::from(n >= 100)];
        *wait_ms = waited_ms.max(*wait_ms);
    }
    waits_ms
}

/// An entry for another node.
const OTHER: (u8, u8, f32) = (9, PWM, 1_500.0);

/// However many they are.
#[test]
fn nodes_that_command_others_in_each_gap_of_a_commander_s_lists_break_none() {
    for attackers in [&[][..], &[10], &[10, 110], &[10, 44, 61, 110]] {
        assert_eq!(waits_ms(attackers, OTHER, 100), [0, 0], "{} attackers", attackers.len());
    }
}

#[test]
fn nodes_that_send_nan_in_each_gap_of_a_commander_s_lists_break_none() {
    for attackers in [&[10][..], &[10, 110]] {
        let waits_ms = waits_ms(attackers, (1, PWM, f32::NAN), 100);
        assert_eq!(waits_ms, [0, 0], "{} attackers", attackers.len());
    }
}

/// At first the node trusts no sender, and follows one of those that send at the same time, in an
/// order that changes: see `src/node/trust.rs`.
#[test]
#[ignore = "takes long: make test-all"]
fn a_commander_that_begins_during_an_attack_is_always_followed_after_two_seconds() {
    let mut longest_ms = 0;
    for attackers in [&[10][..], &[10, 110], &[44, 110]] {
        let [first_ms, later_ms] = waits_ms(attackers, OTHER, 0);
        println!("{attackers:?}: {first_ms} ms, then {later_ms} ms");
        assert!(first_ms <= 500 && later_ms == 0, "{attackers:?}: {first_ms}, {later_ms} ms");
        longest_ms = longest_ms.max(first_ms);
    }
    assert!(longest_ms != 0, "the attackers do nothing");
}
