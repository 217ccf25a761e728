//! Outputs that are relays (feature `relay`): hardpoint.Command and hardpoint.Status, and the pins'
//! levels.

use bench::dronecan::{HardpointStatus, Message};
use bench::wiring::Pin;
use rig::{ARMED, ARRAY_COMMAND, NOT_ARMED, Program, Rig};

const PROGRAM: Program = Program::With("relay");

/// uavcan.equipment.hardpoint.Command of node 10.
const COMMAND: u32 = 0x1804_2E0A;

/// A node whose output 1 is a relay with the ID 5, and output 3 one with the ID 6. Output 2 is a
/// servo.
fn switching() -> Rig {
    PROGRAM.running_set(&[
        ("OUT_COUNT", 3),
        ("OUT1_TYPE", 2),
        ("OUT1_ID", 5),
        ("OUT3_TYPE", 2),
        ("OUT3_ID", 6),
    ])
}

fn pins(rig: &mut Rig) -> [Pin; 2] {
    let wiring = rig.board().wiring();
    [wiring.servo, wiring.outputs[1]]
}

/// Sends a command. Returns the levels of both relays after 20 ms.
fn command(rig: &mut Rig, id: u8, command: u8) -> [bool; 2] {
    rig.send(COMMAND, &[id, command, 0, 0xC0]);
    rig.run_ms(20);
    levels(rig)
}

fn levels(rig: &mut Rig) -> [bool; 2] {
    pins(rig).map(|pin| rig.board().pin(pin))
}

#[test]
fn the_pin_of_a_relay_follows_its_commands_and_stays() {
    let mut rig = switching();
    assert_eq!(levels(&mut rig), [false, false]);
    assert_eq!(command(&mut rig, 6, 1), [false, true]);
    assert_eq!(command(&mut rig, 5, 1), [true, true]);
    assert_eq!(command(&mut rig, 7, 0), [true, true], "no relay here");
    for _ in 0..500 {
        rig.run_ms(1);
        assert_eq!(levels(&mut rig), [true, true], "a level and no pulses");
    }
    assert_eq!(command(&mut rig, 6, 0), [true, false]);
    assert_eq!(command(&mut rig, 5, 0), [false, false]);
    rig.wait_for_line("rx hardpoint.Command from 10 tid 0: 0 for ID 5", 100);
}

#[test]
fn a_relay_keeps_its_state_and_its_sense_when_another_output_becomes_one() {
    let mut rig = switching();
    rig.set_all(&[("OUT1_REVERSED", 1), ("OUT3_REVERSED", 1), ("OUT3_TYPE", 0)]);
    assert_eq!(command(&mut rig, 5, 1), [false, false], "low while it holds");
    rig.set("OUT3_TYPE", 2);
    rig.run_ms(20);
    assert_eq!(levels(&mut rig), [false, true], "one holds, and the other does not");
    assert_eq!(command(&mut rig, 5, 0), [true, true]);
}

#[test]
fn relays_do_not_disturb_the_pulses_of_a_servo_beside_them() {
    let mut rig = switching();
    rig.send(ARRAY_COMMAND | 10, &[2, 0, 0, 0x38, 0xC0]);
    rig.run_ms(100);
    rig.board().take_output_pulses();
    for holds in [1, 0, 1, 0, 1] {
        command(&mut rig, 5, holds);
        command(&mut rig, 6, holds);
    }
    let outputs = rig.board().take_output_pulses();
    let (pulses, relay) = (&outputs[0], &outputs[1]);
    assert!(pulses.len() >= 9, "{pulses:?}");
    for pulse in pulses {
        // 1750 us, and a tick of the timer more or less.
        assert!(pulse.width_cycles.abs_diff(1750 * 16) <= 8, "{pulse:?}");
    }
    assert_eq!(relay.len(), 2, "it held three times, and holds still: {relay:?}");
}

#[test]
fn the_status_of_each_relay_is_sent_once_in_two_seconds() {
    let mut rig = switching();
    command(&mut rig, 6, 1);
    rig.forget();
    rig.run_ms(4100);
    let heard = rig.node_messages(|message| match message {
        Message::HardpointStatus(status) => Some(status),
        _ => None,
    });
    let heard: Vec<HardpointStatus> = heard.into_iter().map(|(_, status)| status).collect();
    assert!((4..=5).contains(&heard.len()), "{heard:?}");
    for (id, status) in [(5, 0), (6, 1)] {
        let mut of_this = heard.iter().filter(|heard| heard.hardpoint == id);
        assert!(of_this.clone().count() >= 2);
        assert!(of_this.all(|heard| heard.status == status && heard.weight.is_nan()), "{heard:?}");
    }
}

/// It goes there a second later at most.
#[test]
fn a_relay_without_commands_for_relay_timeout_goes_to_its_start_whatever_others_get() {
    let mut rig = switching();
    rig.set("RELAY_TIMEOUT", 2);
    // Bits of outputs. A pin of an output with OUTn_REVERSED is high while it is released.
    rig.set("RELAY_START", 0b100);
    rig.set("OUT3_REVERSED", 1);
    assert_eq!(command(&mut rig, 5, 1), [true, true]);
    assert_eq!(command(&mut rig, 6, 0), [true, true]);
    rig.run_ms(1900);
    assert_eq!(command(&mut rig, 6, 0), [true, true]);
    rig.run_ms(1080);
    assert_eq!(levels(&mut rig), [false, true], "the first relay's time is over");
    rig.run_ms(2000);
    assert_eq!(levels(&mut rig), [false, false], "the other one's, too");
}

#[test]
fn a_relay_follows_no_other_command_and_with_arm_req_none_while_disarmed() {
    let mut rig = switching();
    rig.set("ARM_REQ", 1);
    assert_eq!(command(&mut rig, 5, 1), [false, false]);
    rig.wait_for_line("refused: command from 10 tid 0, disarmed", 50);
    rig.arm(ARMED);
    assert_eq!(command(&mut rig, 5, 1), [true, false]);
    rig.arm(NOT_ARMED);
    assert_eq!(command(&mut rig, 5, 0), [true, false]);
    rig.arm(ARMED);
    // An ArrayCommand, and a Command that is too short. A bit mask holds.
    rig.send(ARRAY_COMMAND | 10, &[6, 0, 0, 0x3C, 0xC0]);
    rig.send(COMMAND, &[6, 1, 0xC1]);
    rig.wait_for_line("refused: type 1070 from 10 tid 1, wrong length", 50);
    assert_eq!(levels(&mut rig), [true, false]);
    rig.send(COMMAND, &[6, 0, 0xFF, 0xC2]);
    rig.run_ms(20);
    assert_eq!(levels(&mut rig), [true, true]);
    rig.forget();
    rig.run_ms(2000);
    let statuses = rig.node_messages(|message| match message {
        Message::ActuatorStatus(status) => Some(status.actuator),
        _ => None,
    });
    assert!(statuses.len() > 15 && statuses.iter().all(|(_, id)| *id == 2), "{statuses:?}");
    rig.arm(NOT_ARMED);
    rig.set("OUT1_TYPE", 0);
    rig.run_ms(20);
    assert_eq!(levels(&mut rig), [false, true], "no relay any more");
}

#[test]
fn a_single_output_can_be_a_relay_that_holds_at_the_start() {
    let mut rig = PROGRAM.running();
    rig.set_all(&[("RELAY_START", 1), ("OUT1_TYPE", 2)]);
    rig.run_ms(20);
    let servo = rig.board().wiring().servo;
    assert!(rig.board().pin(servo));
    rig.send(COMMAND, &[1, 0, 0, 0xC0]);
    rig.run_ms(20);
    assert!(!rig.board().pin(servo));
}
