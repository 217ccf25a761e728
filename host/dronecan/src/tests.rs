//! Tests of the codec with bytes of another implementation, pydronecan 1.0.27, in both directions.

use super::*;
use half::f16;
use proptest::prelude::*;
use std::time::Duration;

/// Time of all frames where the time does not matter.
const AT: Duration = Duration::ZERO;

/// Parses the frames of a transfer, separated by `|`: identifier, then the data in hexadecimal. A
/// frame without an identifier has that of the frame before.
#[track_caller]
pub(crate) fn golden(text: &str) -> Vec<Frame> {
    let (mut id, mut frames) = ("", Vec::new());
    for frame in text.split('|') {
        let mut bytes = frame.split_whitespace().peekable();
        id = bytes.next_if(|first| first.len() == 8).unwrap_or(id);
        let data: Vec<u8> = bytes.map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
        frames.push(Frame::extended(u32::from_str_radix(id, 16).unwrap(), &data));
    }
    frames
}

/// The rows of a file of golden messages: the frames of a transfer, and its text.
pub(crate) fn rows(file: &str) -> impl Iterator<Item = (&str, &str)> {
    let mut lines = file.lines().filter(|line| !line.starts_with('#')).map(str::trim);
    std::iter::from_fn(move || Some((lines.next()?, lines.next()?)))
}

fn push(assembler: &mut Assembler, frame: &Frame) -> Outcome {
    let Id::Extended(id) = frame.id else { panic!("standard frame") };
    assembler.push(id, frame.data(), AT)
}

/// Assembles the frames of a golden transfer; the last one must complete it.
#[track_caller]
fn assemble(vector: &str) -> Transfer {
    let mut assembler = Assembler::new();
    let frames = golden(vector);
    let (last, parts) = frames.split_last().unwrap();
    for part in parts {
        assert_eq!(push(&mut assembler, part), Outcome::Partial, "{vector}");
    }
    match push(&mut assembler, last) {
        Outcome::Complete(transfer) => transfer,
        other => panic!("{vector}: not complete: {other:?}"),
    }
}

/// Checks that a golden transfer has this text, and encodes to itself. Returns its message.
#[track_caller]
fn both_ways(vector: &str, text: &str) -> Message {
    let transfer = assemble(vector);
    let message = Message::decode(&transfer);
    assert_eq!(message.to_string(), text, "{vector}");
    let payload = match message.encode() {
        Some((data_type, payload)) => {
            assert_eq!(DataType::of(transfer.id), Some(data_type), "{text}");
            payload
        }
        None => {
            assert!(matches!(message, Message::Other { .. }), "{text} must encode");
            transfer.payload
        }
    };
    assert_eq!(frames(transfer.id, &payload, transfer.transfer_id), golden(vector), "{text}");
    message
}

/// The texts have all fields of these messages. [`battery_info_has_all_its_fields`] and
/// [`node_information_has_all_its_fields`] have the others.
#[test]
fn golden_messages_have_their_texts_and_encode_to_themselves() {
    let mut count = 0;
    for (vector, text) in rows(include_str!("golden.txt")) {
        both_ways(vector, text);
        count += 1;
    }
    assert!(count > 60, "{count}");
}

#[test]
fn battery_info_has_all_its_fields() {
    let message = both_ways(
        "18044478 AA 24 DA 5C 4D 4E 66 89 | C2 00 55 00 51 40 52 29 | 00 3E 0B 37 68 05 03 09 | \
         78 56 34 12 4C 69 50 29 | 6F 20 36 53 49",
        "power.BatteryInfo battery 3 25.20 V -3.20 A 80 % 40.0 Wh 37.4 C CHARGING TEMP_HOT \
         BMS_ERROR",
    );
    let charging = BatteryInfo {
        temperature: f16::from_f32(310.5),
        voltage: f16::from_f32(25.2),
        current: f16::from_f32(-3.2),
        average_power: f16::from_f32(80.0),
        remaining_wh: f16::from_f32(40.0),
        full_wh: f16::from_f32(50.0),
        hours_to_full: f16::from_f32(1.5),
        flags: 0x10B,
        health: 93,
        charge: 80,
        charge_deviation: 5,
        battery: 3,
        model_instance: 0x1234_5678,
        model: b"LiPo 6S".to_vec(),
    };
    assert_eq!(message, Message::BatteryInfo(Box::new(charging)));
}

#[test]
fn node_information_has_all_its_fields() {
    let message = both_ways(
        "1E017FAA 4B 03 0A 00 00 00 00 83 | 00 00 01 02 01 EF BE 23 | AD DE 00 00 00 00 00 03 | \
         00 00 00 01 00 00 01 23 | 02 03 04 05 06 07 08 03 | 09 0A 0B 0C 0D 0E 0F 23 | 00 6F 72 \
         67 2E 65 78 03 | 61 6D 70 6C 65 2E 73 23 | 65 72 76 6F 43",
        "GetNodeInfo response org.example.servo software 1.2 commit deadbeef hardware 1.0 unique \
         ID 000102030405060708090A0B0C0D0E0F",
    );
    let info = NodeInfo {
        status: NodeStatus { uptime_s: 10, ..NodeStatus::default() },
        software: (1, 2),
        commit: Some(0xDEAD_BEEF),
        image_crc: None,
        hardware: (1, 0),
        unique_id: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15],
        certificate: Vec::new(),
        name: b"org.example.servo".to_vec(),
    };
    assert_eq!(message, Message::NodeInfo(Box::new(info)));
}

/// pydronecan does not make these.
#[test]
fn what_is_unknown_cut_or_wrong_is_shown_or_rejected() {
    let wrong = Message::RestartNode(0xBE_EFCA_FE00);
    assert_eq!(wrong.to_string(), "RestartNode request with the wrong number 0xBEEFCAFE00");
    let (voltage, current) = (f16::ZERO, f16::ZERO);
    let status = CircuitStatus { circuit: 1, voltage, current, errors: 0x81 };
    assert_eq!(status.to_string(), "circuit 1 0.00 V 0.00 A OVERVOLTAGE flags 0x80");
    let message = LogMessage { level: 3, source: b"esc".to_vec(), text: b"hot\x1b".to_vec() };
    let text = Message::LogMessage(message).to_string();
    assert_eq!(text, "debug.LogMessage ERROR from esc: hot\\x1b");
    assert_eq!(LogMessage::decode(&[0x25, b'a']), None, "the source is cut");
    assert_eq!(NotifyState::decode(&[0, 3, 1, 2, 0, 0, 0, 0, 0, 0, 0, 0]), None, "no state");
    assert_eq!(NodeStatus::decode(&[0; 8]), None, "a byte too many");
    assert_eq!(Allocation::decode(&[0; 18]), None, "more than a unique ID");
    assert_eq!(BatteryInfo::decode(&[0; 23 + 32]), None, "the name is too long");
    let stats =
        |interfaces: usize| TransportStats::decode(&vec![0; 18 * (1 + interfaces)]).is_some();
    assert_eq!([3, 4].map(stats), [true, false], "at most three interfaces");
    assert!(Temperature::decode(&[0, 0, 0, 0, 1]).unwrap().over);
    let lengths: Vec<usize> = (0..=20).map(|count| (14usize * count).div_ceil(8)).collect();
    for length in (0..=40).filter(|length| !lengths.contains(length)) {
        assert_eq!(esc::decode_commands(&vec![0; length]), None, "{length} bytes");
    }
}

/// The discriminator is the CRC of the payload, shifted (specification, "Anonymous transfers").
#[test]
fn anonymous_identifiers_equal_pydronecan() {
    for vector in [
        "1E974D00 01 00 01 02 03 04 05 C0",
        "1EBC1100 00 06 07 08 09 0A 0B C1",
        "1E9D1D00 00 0C 0D 0E 0F C2",
    ] {
        let transfer = assemble(vector);
        let discriminator = (crc::feed(crc::INITIAL, &transfer.payload) >> 1) & 0x3FFF;
        let expected = CanId::Anonymous { priority: 30, type_id: 1, discriminator };
        assert_eq!(transfer.id, expected);
        assert_eq!(Id::Extended(transfer.id.build()), golden(vector)[0].id);
        assert!(Message::decode(&transfer).to_string().starts_with("Allocation"));
    }
}

/// A row with the ID of another row would never be found.
#[test]
fn each_type_has_an_id_of_its_own() {
    for known in types::KNOWN {
        let source = NodeId::new(1).unwrap();
        let id = match known.kind {
            Kind::Message => known.message_id(16, source),
            Kind::Service => CanId::Service {
                priority: 16,
                service_id: known.id as u8,
                request: true,
                destination: source,
                source,
            },
        };
        assert_eq!(DataType::of(id), Some(known));
    }
}

#[test]
fn a_wrong_byte_in_a_long_transfer_is_noticed() {
    let frames = golden("1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 13 04 DC 65 68");
    let mut assembler = Assembler::new();
    assert_eq!(push(&mut assembler, &frames[0]), Outcome::Partial);
    assert_eq!(push(&mut assembler, &frames[1]), Outcome::Invalid("wrong transfer CRC"));
}

#[test]
fn a_missing_frame_affects_only_its_own_transfer() {
    let payload: Vec<u8> = (0..20).collect();
    let frames = split(&payload, TransferId::new(4), types::ARRAY_COMMAND.seed.unwrap());
    let id = 0x1003_F20A;
    let mut assembler = Assembler::new();
    assert_eq!(assembler.push(id, &frames[0], AT), Outcome::Partial);
    let missing = Outcome::Invalid("a frame of the transfer is missing");
    assert_eq!(assembler.push(id, &frames[2], AT), missing);
    let orphan = Outcome::Invalid("continues a transfer that did not start");
    assert_eq!(assembler.push(id, &frames[3], AT), orphan);
    for frame in &frames[..3] {
        assert_eq!(assembler.push(id, frame, AT), Outcome::Partial);
    }
    assert!(matches!(assembler.push(id, &frames[3], AT), Outcome::Complete(_)));
}

#[test]
fn transfers_of_two_nodes_may_interleave() {
    let payload: Vec<u8> = (0..8).collect();
    let frames = split(&payload, TransferId::new(0), types::ARRAY_COMMAND.seed.unwrap());
    let mut assembler = Assembler::new();
    assert_eq!(assembler.push(0x1003_F20A, &frames[0], AT), Outcome::Partial);
    assert_eq!(assembler.push(0x1003_F20B, &frames[0], AT), Outcome::Partial);
    assert!(matches!(assembler.push(0x1003_F20A, &frames[1], AT), Outcome::Complete(_)));
    assert!(matches!(assembler.push(0x1003_F20B, &frames[1], AT), Outcome::Complete(_)));
}

#[test]
fn a_transfer_times_out_after_two_seconds() {
    let frames = split(&[0; 8], TransferId::new(0), types::ARRAY_COMMAND.seed.unwrap());
    let two_seconds = Duration::from_secs(2);
    for (end, complete) in [(two_seconds, true), (two_seconds + Duration::from_nanos(1), false)] {
        let mut assembler = Assembler::new();
        assembler.push(0x1003_F20A, &frames[0], AT);
        let outcome = assembler.push(0x1003_F20A, &frames[1], end);
        assert_eq!(matches!(outcome, Outcome::Complete(_)), complete);
    }
}

#[test]
fn transfer_ids_count_modulo_32() {
    let mut id = TransferId::new(31);
    assert_eq!(id.advance().get(), 31);
    assert_eq!(id.get(), 0);
}

proptest! {
    /// A terminal shows what nodes send.
    #[test]
    fn no_transfer_has_control_characters_as_text(
        id in 0u32..1 << 29,
        payload in prop::collection::vec(any::<u8>(), 0..80),
        known in 0usize..12,
    ) {
        let known = [
            0x1E0B_F8FF, 0x1E0B_7FF8, 0x1E01_7FF8, 0x1E28_FFF8, 0x1E28_7FF8, 0x183F_F22A,
            0x183F_FF2A,
            0x1807_DA2A, 0x180B_B92A, 0x1E04_7FF8, 0x1400_0000 | 1 << 8 | 42, id,
        ][known];
        // A service frame from or to node 0 is not allowed.
        let Some(id) = CanId::parse(known) else { return Err(TestCaseError::reject("not an ID")) };
        let transfer = Transfer { id, transfer_id: TransferId::new(0), payload, frames: 1 };
        let text = Message::decode(&transfer).to_string();
        prop_assert!(!text.contains(char::is_control), "{:?}", text);
    }

    /// Assembling the frames of a payload gives the payload, at any length.
    #[test]
    fn split_and_assembly_are_inverse(
        payload in prop::collection::vec(any::<u8>(), 0..300),
        number in 0u8..32,
    ) {
        let seed = types::GET_NODE_INFO.seed.unwrap();
        let frames = split(&payload, TransferId::new(number), seed);
        let mut assembler = Assembler::new();
        let mut whole = None;
        for frame in &frames {
            whole = Some(assembler.push(0x1E01_7FAA, frame, AT));
        }
        let Some(Outcome::Complete(transfer)) = whole else { panic!("not complete") };
        prop_assert_eq!(transfer.payload, payload);
        prop_assert_eq!(transfer.frames, frames.len());
    }
}
