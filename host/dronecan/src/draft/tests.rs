//! Tests of the draft's codec with bytes of another implementation, tests/clients/draft.py with
//! pydronecan, in both directions. tests/clients/test_draft.py generates the bytes again.

use super::*;
use crate::tests::{golden, rows};
use crate::{CanId as V0Id, DataType as V0Type, Frame, Id, Kind, NodeId};
use proptest::prelude::*;
use std::time::Duration;

/// Time of all frames where the time does not matter.
const AT: Duration = Duration::ZERO;

fn push(assembler: &mut Assembler, frame: &Frame, at: Duration) -> Outcome {
    let Id::Extended(id) = frame.id else { panic!("standard frame") };
    assembler.push(id, frame.data(), at)
}

/// Assembles the frames of a golden transfer; the last one must complete it.
#[track_caller]
fn assemble(frames: &[Frame]) -> Transfer {
    let mut assembler = Assembler::new();
    let (last, parts) = frames.split_last().unwrap();
    for part in parts {
        assert_eq!(push(&mut assembler, part, AT), Outcome::Partial);
    }
    match push(&mut assembler, last, AT) {
        Outcome::Complete(transfer) => transfer,
        other => panic!("not complete: {other:?}"),
    }
}

/// Checks that a golden transfer has this text, and encodes to itself.
#[track_caller]
fn both_ways(vector: &str, text: &str) -> (Transfer, Message) {
    let frames = golden(vector);
    let transfer = assemble(&frames);
    let message = Message::decode(&transfer);
    assert_eq!(message.to_string(), text, "{vector}");
    let data_type = DataType::of(transfer.type_id, transfer.route.transfer_type());
    let mut again = transfer.clone();
    if let Some((encoded, payload)) = message.encode() {
        assert_eq!(data_type, Some(encoded), "{text}");
        again.payload = payload;
    } else {
        assert!(matches!(message, Message::Other { .. }), "{text} must encode");
    }
    assert_eq!(again.split(data_type.and_then(|known| known.seed).unwrap_or(0)), frames, "{text}");
    (transfer, message)
}

/// The texts have all fields of these messages.
#[test]
fn golden_messages_have_their_texts_and_encode_to_themselves() {
    let mut count = 0;
    for (vector, text) in rows(include_str!("golden.txt")) {
        both_ways(vector, text);
        count += 1;
    }
    assert!(count > 20, "{count}");
}

fn node(id: u8) -> NodeId {
    NodeId::new(id).unwrap()
}

/// The identifier printed in the thesis.
#[test]
fn an_identifier_has_all_its_fields() {
    assert_eq!(398_722_057, 0x17C4_0409);
    let id = CanId::parse(398_722_057).unwrap();
    let expected = CanId {
        type_id: 760,
        transfer_type: TransferType::MessageBroadcast,
        source: node(1),
        index: 0,
        last: true,
        transfer_id: TransferId::new(1),
    };
    assert_eq!(id, expected);
    assert_eq!(expected.build(), 398_722_057);
}

#[test]
fn forbidden_identifiers_are_rejected() {
    let id = |index: u32, last: bool, source: u32| {
        760 << 19 | 2 << 17 | source << 10 | index << 4 | u32::from(last) << 3
    };
    assert!(CanId::parse(id(62, true, 1)).is_some());
    assert!(CanId::parse(id(61, false, 127)).is_some());
    assert_eq!(
        CanId::parse(id(62, false, 1)),
        None,
        "not the last frame, but with the highest index"
    );
    assert_eq!(CanId::parse(id(63, true, 1)), None, "reserved");
    assert_eq!(CanId::parse(id(0, true, 0)), None, "from node 0");
}

/// Uptime 300 s, health 0, mode 0, in the fields of v0.
#[test]
fn the_thesis_s_seven_bytes_are_an_ok_status() {
    let transfer = assemble(&golden("1134780A 2C 01 00 00 00 34 12"));
    let expected =
        NodeStatus { uptime_s: 300, code: StatusCode::Ok, vendor_code: VendorCode::Short(0x1234) };
    assert_eq!(Message::decode(&transfer), Message::NodeStatus(expected));
    assert_eq!(transfer.endpoints(), "30");
}

#[test]
fn a_status_can_be_converted_to_v0() {
    let shown = |code| {
        let status = NodeStatus { uptime_s: 5, code, vendor_code: VendorCode::Long(0xDEAD_BEEF) };
        crate::NodeStatus::from(status).to_string()
    };
    assert_eq!(shown(StatusCode::Ok), "OK OPERATIONAL up 5 s vendor 0xBEEF");
    assert_eq!(shown(StatusCode::Initializing), "OK INITIALIZATION up 5 s vendor 0xBEEF");
    assert_eq!(shown(StatusCode::Warning), "WARNING OPERATIONAL up 5 s vendor 0xBEEF");
    assert_eq!(shown(StatusCode::Critical), "CRITICAL OPERATIONAL up 5 s vendor 0xBEEF");
    assert_eq!(shown(StatusCode::Offline), "OK OFFLINE up 5 s vendor 0xBEEF");
}

#[test]
fn commands_are_three_bytes_each() {
    assert_eq!(ActuatorCommand::decode_array(&[0; 93]).map(|commands| commands.len()), Some(31));
    assert_eq!(ActuatorCommand::decode_array(&[0; 96]), None);
    assert_eq!(ActuatorCommand::decode_array(&[0; 4]), None);
}

#[test]
fn node_info_has_the_destination_in_each_frame() {
    let (transfer, _) = both_ways("113BFC08 78", "draft.GetNodeInfo request");
    assert_eq!(
        (transfer.route, transfer.endpoints().as_str()),
        (Route::Request(node(120)), "127>120")
    );
    let (transfer, message) = both_ways(
        "1139E005 7F 7F 9B 0A 00 00 01 34 | 1139E015 7F 12 01 02 01 EF BE AD | 1139E025 7F DE 00 \
         00 00 00 00 00 | 1139E035 7F 00 00 01 00 00 01 02 | 1139E045 7F 03 04 05 06 07 08 09 | \
         1139E055 7F 0A 0B 0C 0D 0E 0F 00 | 1139E065 7F 6F 72 67 2E 65 78 61 | 1139E075 7F 6D 70 \
         6C 65 2E 73 65 | 1139E08D 7F 72 76 6F",
        "draft.GetNodeInfo response org.example.servo software 1.2 commit deadbeef hardware 1.0 \
         unique ID 000102030405060708090A0B0C0D0E0F",
    );
    assert_eq!(transfer.route, Route::Response(node(127)));
    let Message::NodeInfo(info) = message else { panic!("{message}") };
    let expected = NodeStatus {
        uptime_s: 10,
        code: StatusCode::Initializing,
        vendor_code: VendorCode::Short(0x1234),
    };
    assert_eq!(info.status, expected);
}

#[test]
fn a_node_status_has_no_other_length() {
    for length in [0, 1, 2, 3, 5] {
        let frame = Frame::extended(0x1134_0408, &[0; 8][..length]);
        let message = Message::decode(&assemble(&[frame]));
        assert!(matches!(message, Message::Other { .. }), "{length} bytes: {message}");
    }
}

/// A response always has a vendor code of 16 bits, even if the node's own status has another
/// length.
#[test]
fn a_status_in_a_response_has_six_bytes() {
    for vendor_code in [VendorCode::None, VendorCode::Short(0), VendorCode::Long(0x1_0000)] {
        let status = NodeStatus { vendor_code, ..NodeStatus::default() };
        let payload = NodeInfo { status, name: b"x".to_vec(), ..NodeInfo::default() }.encode();
        assert_eq!(payload.len(), 6 + 15 + 18 + 1 + 1);
    }
}

/// Bool and int64 at once: length 1, true, length 1, the 64 bits of 7, then no float and no string,
/// index 0.
#[test]
fn of_several_values_the_first_is_used() {
    let payload = [0b1110_0000, 0b1110_0000, 0, 0, 0, 0, 0, 0, 0, 0];
    let id = CanId::parse(0x12BB_FC08).unwrap();
    let transfer = Transfer {
        type_id: id.type_id,
        source: id.source,
        route: Route::Request(node(120)),
        transfer_id: id.transfer_id,
        payload: payload.to_vec(),
    };
    let text = Message::decode(&transfer).to_string();
    assert_eq!(text, "draft.param.GetSet request index 0 = true");
}

#[test]
fn frames_with_a_wrong_destination_are_rejected() {
    for (vector, why) in [
        ("113BFC08", "no destination"),
        ("113BFC08 F8", "no valid destination"),
        ("113BFC08 00", "no valid destination"),
        ("113BFC08 7F", "to its own sender"),
        ("113BFFF8 78", "forbidden identifier"),
    ] {
        let outcome = push(&mut Assembler::new(), &golden(vector)[0], AT);
        assert_eq!(outcome, Outcome::Invalid(why), "{vector}");
    }
}

const MISSING: Outcome = Outcome::Invalid("a frame of the transfer is missing");
const FOUR_COMMANDS: &str = "084C0403 BE 8D 01 00 38 02 00 BC | 084C041B 03 00 34 04 00 3C";

#[test]
fn a_wrong_byte_in_a_long_transfer_is_noticed() {
    let vector = FOUR_COMMANDS.replace("34 04", "35 04");
    let frames = golden(&vector);
    let mut assembler = Assembler::new();
    assert_eq!(push(&mut assembler, &frames[0], AT), Outcome::Partial);
    assert_eq!(push(&mut assembler, &frames[1], AT), Outcome::Invalid("wrong transfer CRC"));
}

#[test]
fn frames_with_another_transfer_id_do_not_continue_a_transfer() {
    let frames = golden(&FOUR_COMMANDS.replace("084C041B", "084C041C"));
    let mut assembler = Assembler::new();
    assert_eq!(push(&mut assembler, &frames[0], AT), Outcome::Partial);
    assert_eq!(push(&mut assembler, &frames[1], AT), MISSING);
}

#[test]
fn a_transfer_times_out_after_five_seconds() {
    let frames = golden(FOUR_COMMANDS);
    let limit = Duration::from_secs(5);
    for (end, complete) in [(limit, true), (limit + Duration::from_nanos(1), false)] {
        let mut assembler = Assembler::new();
        push(&mut assembler, &frames[0], AT);
        let outcome = push(&mut assembler, &frames[1], end);
        assert_eq!(matches!(outcome, Outcome::Complete(_)), complete);
    }
}

#[test]
fn only_the_last_frame_may_be_short() {
    let short = |vector: &str, why| {
        let mut assembler = Assembler::new();
        let outcomes: Vec<_> =
            golden(vector).iter().map(|frame| push(&mut assembler, frame, AT)).collect();
        assert_eq!(outcomes.last(), Some(&Outcome::Invalid(why)));
    };
    short("084C0403 BE 8D 01 00 38 02 00", "start frame that is not full");
    short("084C0403 BE 8D 01 00 38 02 00 BC | 084C0413 03 00", "middle frame that is not full");
}

#[test]
fn a_broadcast_frame_has_eight_bytes_and_other_frames_seven() {
    let frames = |route, len| {
        let payload = vec![0; len];
        let transfer = Transfer {
            type_id: 1,
            source: node(1),
            route,
            transfer_id: TransferId::new(0),
            payload,
        };
        transfer.split(0).len()
    };
    assert_eq!([0, 8, 9, 14, 15].map(|len| frames(Route::Broadcast, len)), [1, 1, 2, 2, 3]);
    assert_eq!([0, 7, 8, 12, 13].map(|len| frames(Route::Unicast(node(2)), len)), [1, 1, 2, 2, 3]);
    assert_eq!(frames(Route::Request(node(2)), transfer::PAYLOAD_MAX), 63);
    assert_eq!(transfer::PAYLOAD_MAX, 439);
}

/// [`dialect`](crate::dialect) needs this: an identifier of a known type of one dialect is not one
/// of a known type of the other, except anonymous frames of v0 and the draft's messages to one
/// node.
#[test]
fn no_identifier_is_a_known_type_of_both_dialects() {
    for known in types::KNOWN {
        for transfer_type in 0..4 {
            for rest in 0..1 << 17 {
                let id = u32::from(known.id) << 19 | transfer_type << 17 | rest;
                let Some(draft) = CanId::parse(id) else { continue };
                if draft.transfer_type.kind() != known.kind
                    || draft.transfer_type == TransferType::MessageUnicast
                {
                    continue;
                }
                if let Some(v0) = V0Id::parse(id).filter(|v0| !matches!(v0, V0Id::Anonymous { .. }))
                {
                    assert_eq!(V0Type::of(v0), None, "{} is {v0:?} too", known.name);
                }
            }
        }
    }
}

proptest! {
    /// No payload of any type may cause a panic.
    #[test]
    fn no_payload_causes_a_panic(
        known in 0..types::KNOWN.len(),
        way in 0..2,
        payload in prop::collection::vec(any::<u8>(), 0..100),
    ) {
        let DataType { kind, id, .. } = types::KNOWN[known];
        let route = match (kind, way) {
            (Kind::Message, 0) => Route::Broadcast,
            (Kind::Message, _) => Route::Unicast(node(2)),
            (Kind::Service, 0) => Route::Request(node(2)),
            (Kind::Service, _) => Route::Response(node(2)),
        };
        let transfer_id = TransferId::new(0);
        let transfer = Transfer { type_id: id, source: node(1), route, transfer_id, payload };
        let message = Message::decode(&transfer);
        if let Some((data_type, payload)) = message.encode() {
            prop_assert_eq!(data_type.id, id);
            let again = Message::decode(&Transfer { payload, ..transfer });
            prop_assert_eq!(format!("{:?}", again), format!("{:?}", message));
        }
    }

    /// Assembling the frames of a payload gives the payload, at any length, to all nodes or to one.
    #[test]
    fn split_and_assembly_are_inverse(
        payload in prop::collection::vec(any::<u8>(), 0..=transfer::PAYLOAD_MAX),
        number in 0u8..8,
        to_one in any::<bool>(),
    ) {
        let to_127 = (551, Route::Response(node(127)));
        let (type_id, route) = if to_one { to_127 } else { (265, Route::Broadcast) };
        let transfer_id = TransferId::new(number);
        let transfer = Transfer { type_id, source: node(120), route, transfer_id, payload };
        let seed = DataType::of(type_id, route.transfer_type()).unwrap().seed.unwrap();
        let frames = transfer.split(seed);
        prop_assert_eq!(assemble(&frames), transfer);
    }
}
