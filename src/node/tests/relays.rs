//! Outputs that are relays.

use super::*;

/// Four outputs: 2 and 3 are relays with the IDs 5 and 6, and 3 is low while it holds.
fn with_relays(values: &[(Parameter, i32)]) -> Rig {
    let relays = [
        (Parameter::OutCount, 4),
        (OutputParameter::Type.of(1), 2),
        (OutputParameter::Id.of(1), 5),
        (OutputParameter::Type.of(2), 2),
        (OutputParameter::Id.of(2), 6),
        (OutputParameter::Reversed.of(2), 1),
    ];
    let mut rig = Rig::with(&[&relays[..], values].concat());
    rig.run(10);
    rig
}

/// Sends a hardpoint.Command from node 10. Returns the levels of the outputs 2 and 3.
fn command(rig: &mut Rig, id: u8, command: u16) -> [bool; 2] {
    let [low, high] = command.to_le_bytes();
    rig.hear(&golden::frame(0x1804_2E0A, &[id, low, high, 0xC0]));
    levels(rig)
}

/// Levels of the outputs 2 and 3. Each gets its level once in eight milliseconds.
fn levels(rig: &mut Rig) -> [bool; 2] {
    rig.run(8);
    assert!(!rig.servos.1[0] && !rig.servos.1[3], "the others are servos");
    assert_eq!(rig.servos.0[1..3], [0, 0], "no pulses");
    [rig.servos.1[1], rig.servos.1[2]]
}

#[test]
fn the_golden_command_holds_and_0_releases() {
    let mut rig = with_relays(&[(OutputParameter::Id.of(1), 1)]);
    assert_eq!(levels(&mut rig), [false, true], "released");
    rig.text("18042E0A 01 01 00 C0");
    assert_eq!(levels(&mut rig), [true, true]);
    assert_eq!(command(&mut rig, 1, 0), [false, true]);
    assert_eq!(command(&mut rig, 6, 1), [false, false]);
    assert_eq!(command(&mut rig, 6, 0xFF00), [false, false], "a bit mask holds");
    assert_eq!(command(&mut rig, 3, 1), [false, false], "output 4 is a servo");
}

#[test]
fn a_relay_without_commands_for_relay_timeout_goes_to_its_start_whatever_others_get() {
    let mut rig = with_relays(&[(Parameter::RelayTimeout, 3), (Parameter::RelayStart, 0b0100)]);
    assert_eq!(levels(&mut rig), [false, false]);
    assert_eq!(command(&mut rig, 5, 1), [true, false]);
    assert_eq!(command(&mut rig, 6, 0), [true, true]);
    rig.run(2900);
    assert_eq!(command(&mut rig, 6, 0), [true, true]);
    // The first relay's time is over.
    rig.run(1080);
    assert_eq!(levels(&mut rig), [false, true]);
    for _ in 0..3 {
        assert_eq!(command(&mut rig, 6, 0), [false, true]);
        rig.run(2900);
    }
    assert_eq!(levels(&mut rig), [false, true]);
    rig.run(1100);
    assert_eq!(levels(&mut rig), [false, false]);
}

#[test]
fn a_relay_holds_for_relay_timeout_at_least_and_a_second_longer_at_most() {
    for phase_ms in (0..1000).step_by(90) {
        let mut rig = with_relays(&[(Parameter::RelayTimeout, 1)]);
        rig.run(phase_ms);
        assert_eq!(command(&mut rig, 5, 1), [true, true], "{phase_ms} ms");
        rig.run(970);
        assert_eq!(levels(&mut rig), [true, true], "{phase_ms} ms");
        rig.run(1030);
        assert_eq!(levels(&mut rig), [false, true], "{phase_ms} ms");
    }
}

#[test]
fn with_arm_req_a_relay_follows_only_while_armed() {
    let mut rig = with_relays(&[(Parameter::ArmReq, 1)]);
    assert_eq!(command(&mut rig, 5, 1), [false, true]);
    assert_eq!(rig.program.node.health().counts.refused, 1);
    rig.status_of(10);
    rig.hear(&golden::frame(0x1804_4C0A, &[255, 0xC0]));
    assert_eq!(command(&mut rig, 5, 1), [true, true]);
    rig.hear(&golden::frame(0x1804_4C0A, &[0, 0xC1]));
    assert_eq!(command(&mut rig, 5, 0), [true, true]);
}

#[test]
fn a_relay_follows_no_other_command_and_a_command_of_another_length_is_refused() {
    let mut rig = with_relays(&[]);
    rig.hear(&golden::frame(0x1003_F20A, &[5, 0, 0, 0x3C, 0xC0]));
    assert_eq!(levels(&mut rig), [false, true]);
    assert_eq!(rig.program.node.health().counts.refused, 0);
    rig.hear(&golden::frame(0x1804_2E0A, &[5, 1, 0xC1]));
    assert_eq!(levels(&mut rig), [false, true]);
    assert_eq!(rig.program.node.health().counts.refused, 1);
}

#[test]
fn an_output_that_is_no_relay_any_more_gets_the_low_level() {
    let mut rig = with_relays(&[]);
    assert_eq!(command(&mut rig, 5, 1), [true, true]);
    rig.set(OutputParameter::Type.of(1), 0);
    assert_eq!(levels(&mut rig), [false, true]);
}

#[test]
fn relays_have_no_actuator_status() {
    let mut rig = with_relays(&[]);
    rig.run(2100);
    let statuses = rig.transfers(ACTUATOR_STATUS, golden::ACTUATOR_STATUS);
    let ids: Vec<u8> = statuses.into_iter().map(|(_, payload, _)| payload[0]).collect();
    assert!(ids.len() > 15 && ids.iter().all(|id| [1, 4].contains(id)), "{ids:?}");
}
