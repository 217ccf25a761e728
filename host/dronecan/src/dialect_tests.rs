//! Tests that each frame gets its dialect, on buses with one dialect and with both.

use super::*;
use crate::Frame;
use crate::Id;

/// Decodes frames in candump's format. Returns their messages as text.
fn heard(observer: &mut Observer, frames: &[&str]) -> Vec<String> {
    let hear = |text: &&str| {
        let frame: Frame = text.parse().unwrap();
        let Id::Extended(id) = frame.id else { panic!("standard frame") };
        match observer.push(id, frame.data(), Duration::ZERO) {
            Observation::Complete(transfer) => format!("{} {transfer}", transfer.endpoints()),
            Observation::Partial => String::from("partial"),
            Observation::Invalid(why) => format!("invalid: {why}"),
        }
    };
    frames.iter().map(hear).collect()
}

const STATUS: &str = "1801550A#01000000000000C0";
const DRAFT_STATUS: &str = "1135E00B#EFCDAB02";

#[test]
fn known_types_of_both_dialects_are_recognised_on_one_bus() {
    let expected = [
        ("1003F20A#01000038C7", "10 ArrayCommand id 1 unitless +0.50"),
        ("17C40409#5A", "1 draft.ThesisCommand 90"),
        (STATUS, "10 NodeStatus OK OPERATIONAL up 1 s vendor 0x0000"),
        ("084C0409#010038", "1 draft.ArrayCommand id 1 +0.50"),
        (DRAFT_STATUS, "120 draft.NodeStatus WARNING up 11259375 s"),
        ("1003F20A#01000038C8", "10 ArrayCommand id 1 unitless +0.50"),
        ("113BFC08#78", "127>120 draft.GetNodeInfo request"),
        ("1E01F8FF#C3", "127>120 GetNodeInfo request"),
        ("1E974D00#01000102030405C0", "anon Allocation first part unique ID 000102030405"),
    ];
    let frames = expected.map(|(frame, _)| frame);
    assert_eq!(heard(&mut Observer::new(), &frames), expected.map(|(_, text)| text));
}

/// 0x06F40408 is message 222 of node 1 in the draft, and message 0xF404 of node 8 in v0. In v0 0xC0
/// is a tail byte.
#[test]
fn unknown_types_have_the_dialect_of_the_last_status() {
    let unknown = "06F40408#01C0";
    let mut observer = Observer::new();
    assert_eq!(heard(&mut observer, &[unknown]), ["8 message 62468 01"]);
    assert_eq!(heard(&mut observer, &[DRAFT_STATUS, unknown])[1], "1 draft message 222 01C0");
    assert_eq!(heard(&mut observer, &[STATUS, unknown])[1], "8 message 62468 01");
}

#[test]
fn an_invalid_status_does_not_change_the_dialect() {
    let unknown = "06F40408#01C0";
    for broken in ["1135E00B#EFCDAB0200", "1135E01B#EFCDAB02", "1135E003#EFCDAB02EFBE0000"] {
        assert_eq!(
            heard(&mut Observer::new(), &[broken, unknown])[1],
            "8 message 62468 01",
            "{broken}"
        );
    }
    for broken in
        ["1801550A#010000000000C0", "1801550A#0100000000000080", "1801550A#01000000000000E0"]
    {
        let heard = heard(&mut Observer::new(), &[DRAFT_STATUS, broken, unknown]);
        assert_eq!(heard[2], "1 draft message 222 01C0", "{broken}");
    }
}

#[test]
fn transfers_of_several_frames_of_both_dialects_may_interleave() {
    let frames = [
        "1003F20A#12F3010000380288",
        "084C0403#BE8D0100380200BC",
        "1003F20A#0000BC0304DC6568",
        "084C041B#03003404003C",
    ];
    let expected = [
        "partial",
        "partial",
        "10 ArrayCommand id 1 unitless +0.50, id 2 unitless -1.00, id 3 PWM 1500 us",
        "1 draft.ArrayCommand id 1 +0.50, id 2 -1.00, id 3 +0.25, id 4 +1.00",
    ];
    assert_eq!(heard(&mut Observer::new(), &frames), expected);
}

#[test]
fn an_invalid_frame_has_the_reason_of_its_dialect() {
    let frames = ["1003F20A#0000000000000020", "113BFC08#F8"];
    let expected =
        ["invalid: continues a transfer that did not start", "invalid: no valid destination"];
    assert_eq!(heard(&mut Observer::new(), &frames), expected);
}

#[test]
fn an_identifier_has_its_sender_and_type() {
    let name =
        |dialect, id| announced(dialect, id).map(|(source, name)| (source.map(NodeId::get), name));
    let of = |source, name: &str| Some((source, String::from(name)));
    assert_eq!(name(Dialect::V0, 0x1003_F20A), of(Some(10), "ArrayCommand"));
    assert_eq!(name(Dialect::V0, 0x1E97_4D00), of(None, "Allocation"));
    assert_eq!(name(Dialect::Draft, 0x084C_0413), of(Some(1), "draft.ArrayCommand"));
    assert_eq!(name(Dialect::Draft, 0x113B_FFF8), None);
}
