//! Two nodes that command the same output, and which node may arm.

use bench::avr::Chip;
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

/// Each attacker ends a list that it began and begins another, before each list of the commander and
/// in each gap of it. Returns the longest time in milliseconds that passed between two lists that
/// the node followed, or until the first one.
fn longest_wait_ms(attackers: &[u32]) -> u32 {
    const PERIOD_MS: u32 = 20;
    let mut rig = Rig::running();
    let whole = array_command(&[(9, 0, 0.0); 2], 0);
    let attack = |rig: &mut Rig| {
        for source in attackers {
            rig.send(ARRAY_COMMAND | source, &whole[1]);
            rig.send(ARRAY_COMMAND | source, &whole[0]);
        }
    };
    // Commands of two frames that nobody disturbs.
    for source in attackers {
        whole.iter().for_each(|data| rig.send(ARRAY_COMMAND | source, data));
    }
    let (mut longest_ms, mut waited_ms) = (0, 0);
    for n in 0..200 {
        let begins = rig.now();
        let us = 1_100.0 + 4.0 * n as f32;
        let mut entries = [(2, PWM, 1_500.0); 15];
        entries[0] = (1, PWM, us);
        for data in array_command(&entries, n % 32) {
            attack(&mut rig);
            rig.send(ARRAY_COMMAND | 60, &data);
        }
        rig.run_until(begins + u64::from(PERIOD_MS) * MS);
        // The pulse that begins now may have the width of the list before.
        let followed_us = rig.pulses.last().map_or(0.0, |pulse| pulse.width_us());
        waited_ms += PERIOD_MS;
        if followed_us >= f64::from(us) - 5.0 {
            waited_ms = 0;
        }
        longest_ms = longest_ms.max(waited_ms);
    }
    longest_ms
}

/// The node cannot tell which list will be complete. With one lane for lists, it follows one of two
/// nodes, in an order that changes: see `crates/dronecan-wire/src/receive/trust.rs`.
#[test]
fn nodes_that_begin_a_list_in_each_gap_of_the_commander_s_do_not_keep_it_out() {
    let has_two_lanes = rig::board().chip == Chip::Atmega328p;
    for (attackers, most_ms) in [(&[][..], 0), (&[10], 80), (&[10, 110], 500)] {
        let longest_ms = longest_wait_ms(attackers);
        println!("{} attackers: {longest_ms} ms", attackers.len());
        assert!(longest_ms <= most_ms, "{} attackers: {longest_ms} ms", attackers.len());
        // With two lanes, one attacker takes one.
        let is_harmless = attackers.len() <= usize::from(has_two_lanes);
        assert_eq!(longest_ms == 0, is_harmless, "{} attackers", attackers.len());
    }
}
