//! The draft on the wire, and the node of the thesis on a desk.

use super::*;
use crate::desk::{Desk, Memory};
use crate::golden::{bytes, frame, frames};
use crate::tables::condition::ResetCause;

fn read(text: &str) -> Result<(Kind, u8, u8, Vec<u8>), Rejection> {
    let frames = frames(text);
    segment(&frames[0], 120).map(|s| (s.kind, s.source, s.tail.0, s.payload.to_vec()))
}

#[test]
fn messages_are_read_with_their_transfer_id() {
    // NodeStatus from node 119 (120 is this node's own ID), the thesis's command from node 1.
    for (text, kind, source, tail, payload) in [
        ("1135DC0B EF CD AB 02 EF BE", Kind::NodeStatus, 119, 0xC3, "EF CD AB 02 EF BE"),
        ("17C40409 5A", Kind::ServoCommand, 1, 0xC1, "5A"),
    ] {
        assert_eq!(read(text), Ok((kind, source, tail, bytes(payload))), "{text}");
    }
}

#[test]
fn a_part_of_a_longer_transfer_is_malformed() {
    for text in ["17C40401 5A", "17C40419 5A", "17C40509 5A"] {
        assert_eq!(read(text), Err(Rejection::Malformed), "{text}");
    }
}

#[test]
fn a_frame_with_this_nodes_id_or_with_none_is_rejected() {
    assert_eq!(read("1135E00B EF CD AB 02"), Err(Rejection::OwnId));
    assert_eq!(read("1134000B EF CD AB 02"), Err(Rejection::Anonymous));
}

#[test]
fn a_frame_that_is_rejected_has_a_type_and_a_sender_all_the_same() {
    for (text, expected) in [
        ("17C40409 5A", (760, 1)),
        ("17C42419", (760, 9)),
        ("17C40008 00", (760, 0)),
        ("1135E00B EF CD AB 02", (550, 120)),
        ("1135FC0B EF", (550, 127)),
    ] {
        assert_eq!(origin(&frames(text)[0]), expected, "{text}");
    }
}

#[test]
fn frames_of_v0_and_of_other_types_are_unknown() {
    for text in [
        "1801550A 0A 00 00 00 00 00 00 C1",
        "1003F20A 01 04 00 66 C0",
        "084C040A 01 00 38",
        "1139E005 7F 00",
        "17CDE008 17",
        "113BFC0D 78",
    ] {
        assert_eq!(read(text), Err(Rejection::Unknown), "{text}");
    }
}

/// NodeStatus of node 1.
const STATUS: &str = "1134040B 01 00 00 00 00 00";

/// NodeStatus, and the measurement, of node 120, without their transfer IDs.
const OWN_STATUS: [u8; 3] = [0x11, 0x35, 0xE0];
const OWN_MEASUREMENT: [u8; 3] = [0x17, 0xCD, 0xE0];

fn node() -> Desk {
    let mut desk = Desk::start(Memory::blank(), ResetCause::POWER_ON);
    desk.settle();
    desk
}

fn run(desk: &mut Desk, ms: u32) {
    for _ in 0..ms {
        desk.pass(1);
    }
}

/// The frames sent with this identifier: transfer ID and data.
fn sent(desk: &Desk, id: [u8; 3]) -> Vec<(u8, Vec<u8>)> {
    let frames = desk.can.sent.iter().map(|(_, frame)| frame);
    let frames = frames.filter(|frame| frame.id[..3] == id);
    frames.map(|frame| (frame.id[3], frame.data().to_vec())).collect()
}

#[test]
fn the_command_moves_the_servo_over_its_travel() {
    let mut desk = node();
    for (position, pulse_us) in [(0, 1000), (255, 2000), (51, 1200)] {
        desk.hear(&frame(0x17C4_0409, &[position]));
        assert_eq!(desk.servos.0[0], 2 * pulse_us);
    }
}

#[test]
fn frames_of_v0_move_nothing_and_are_not_answered() {
    let mut desk = node();
    for text in ["1003F20A 01 04 00 66 C0", "18045701 80 C0", "1E01F8FF C3"] {
        desk.hear(&frames(text)[0]);
    }
    run(&mut desk, 1100);
    assert_eq!(desk.servos.0[0], 0);
    assert!(desk.can.sent.iter().all(|(_, frame)| frame.id[..3] == OWN_STATUS));
}

#[test]
fn the_status_has_28_bits_of_uptime_a_code_and_the_vendor_code() {
    let mut desk = node();
    run(&mut desk, 2100);
    let statuses = sent(&desk, OWN_STATUS);
    let (transfer_id, data) = statuses.last().unwrap();
    assert_eq!((*transfer_id, data[..].to_vec()), (0x0A, bytes("02 00 00 00 00 80")));
}

#[test]
fn the_temperature_is_sent_for_every_third_status_of_the_autopilot() {
    let mut desk = node();
    for _ in 0..9 {
        desk.hear(&frames(STATUS)[0]);
        run(&mut desk, 1000);
    }
    let expected = [(8, vec![25]), (9, vec![25]), (10, vec![25])];
    assert_eq!(sent(&desk, OWN_MEASUREMENT), expected);
}

#[test]
fn the_temperature_stays_within_a_byte() {
    for (readings, expected) in [([1, 1], 0), ([1022, 1022], 255)] {
        let mut desk = node();
        desk.readings = readings;
        for _ in 0..4 {
            desk.hear(&frames(STATUS)[0]);
            run(&mut desk, 1000);
        }
        assert_eq!(sent(&desk, OWN_MEASUREMENT)[0].1, [expected]);
    }
}

#[cfg(feature = "button")]
#[test]
fn presses_of_the_button_share_the_transfer_ids_of_the_temperature() {
    let mut desk = node();
    desk.is_pressed = true;
    run(&mut desk, 100);
    for _ in 0..3 {
        desk.hear(&frames(STATUS)[0]);
        run(&mut desk, 1000);
    }
    assert_eq!(sent(&desk, OWN_MEASUREMENT), [(8, vec![1]), (9, vec![25])]);
}

#[test]
fn the_filters_are_those_of_the_thesis_from_any_node() {
    let registers = FILTERS.unwrap().map(|pattern| u32::from_be_bytes(pattern.registers()));
    let expected = [0x17C4_0408, 0x1134_0408, 0x1FFE_0008];
    let [command, status, ..] = expected.map(u32::to_be_bytes).map(Pattern::filter);
    let mask = Pattern::mask(0x1FFE_0008u32.to_be_bytes());
    let expected = [command, status, command, status, command, status, mask, mask];
    assert_eq!(registers, expected.map(|pattern| u32::from_be_bytes(pattern.registers())));
}
