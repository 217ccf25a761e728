//! Tests of the bytes of messages in both directions.

use super::*;
use crate::number::IntegerEncoding;
use crate::signing::{Rejection, Signer, Signing};
use mavlink::dialects::common::{
    COMMAND_LONG_DATA, MavCmd, PARAM_REQUEST_LIST_DATA, RADIO_STATUS_DATA,
};
use mavlink::{MAVLinkV2MessageRaw, MavHeader, MavlinkVersion};
use std::cell::RefCell;
use std::rc::Rc;

/// Header length of a frame of version 2: magic, length, two flags, sequence, system, component,
/// three bytes of message ID.
const V2_HEADER: usize = 10;
const V1_HEADER: usize = 6;
/// Offset of COMMAND_LONG.command in its payload.
const COMMAND_AT: usize = 28;

fn writer(versions: Versions) -> Writer {
    Writer::new(1, versions, None)
}

fn key(byte: u8) -> Option<Signer> {
    Some(Signer::new(Rc::new(RefCell::new(Signing::new([byte; 32]))), 0))
}

fn heartbeat() -> Out {
    Out { component: 126, content: Content::from(MavMessage::HEARTBEAT(HEARTBEAT_DATA::default())) }
}

fn status(mode: u8) -> Out {
    let data = UAVCAN_NODE_STATUS_DATA { uptime_sec: 5, ..UAVCAN_NODE_STATUS_DATA::default() };
    Out { component: 42, content: Content::Status { data, mode } }
}

fn ack(command: u16) -> Out {
    let content =
        Content::Ack { command, result: MavResult::MAV_RESULT_UNSUPPORTED, to: (255, 190) };
    Out { component: 42, content }
}

/// A ground station's message, as the crate encodes it.
fn sent(message: &MavMessage) -> Vec<u8> {
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.serialize_message(MavHeader { system_id: 255, component_id: 190, sequence: 0 }, message);
    raw.raw_bytes().to_vec()
}

fn parsed(bytes: &[u8]) -> Vec<In> {
    let mut parser = Parser::new(None);
    parser.feed(bytes);
    std::iter::from_fn(|| parser.message())
        .filter_map(|message| message.ok().map(|(_, message)| message))
        .collect()
}

#[test]
fn the_first_message_has_version_2_and_the_next_the_station_s_version() {
    let mut writer = writer(Versions::Auto);
    let v1 = Some(MavlinkVersion::V1);
    assert_eq!(writer.bytes(&heartbeat(), v1, IntegerEncoding::Bytewise).unwrap()[0], 0xFD);
    assert_eq!(writer.bytes(&heartbeat(), v1, IntegerEncoding::Bytewise).unwrap()[0], 0xFE);
    assert_eq!(writer.bytes(&status(0), v1, IntegerEncoding::Bytewise).unwrap()[0], 0xFD);
    assert_eq!(
        writer.bytes(&heartbeat(), Some(MavlinkVersion::V2), IntegerEncoding::Bytewise).unwrap()[0],
        0xFD
    );
}

#[test]
fn a_given_version_is_always_used() {
    let mut one = writer(Versions::One);
    assert_eq!(one.bytes(&heartbeat(), None, IntegerEncoding::Bytewise).unwrap()[0], 0xFE);
    assert_eq!(one.bytes(&status(0), Some(MavlinkVersion::V2), IntegerEncoding::Bytewise), None);
    let mut two = writer(Versions::Two);
    two.bytes(&heartbeat(), Some(MavlinkVersion::V1), IntegerEncoding::Bytewise);
    assert_eq!(
        two.bytes(&heartbeat(), Some(MavlinkVersion::V1), IntegerEncoding::Bytewise).unwrap()[0],
        0xFD
    );
}

#[test]
fn each_component_has_its_own_sequence_numbers() {
    let mut writer = writer(Versions::Two);
    let mut sequence = |out: &Out| writer.bytes(out, None, IntegerEncoding::Bytewise).unwrap()[4];
    let numbers = [
        sequence(&heartbeat()),
        sequence(&status(0)),
        sequence(&heartbeat()),
        sequence(&status(0)),
    ];
    assert_eq!(numbers, [0, 0, 1, 1]);
}

/// The crate's enumeration does not have this mode.
#[test]
fn an_undefined_mode_is_passed_on() {
    for mode in 0..8 {
        let bytes =
            writer(Versions::Two).bytes(&status(mode), None, IntegerEncoding::Bytewise).unwrap();
        // MAVLink 2 does not send trailing zeros; mode is the field before the last.
        let sent =
            bytes[V2_HEADER..V2_HEADER + usize::from(bytes[1])].get(15).copied().unwrap_or(0);
        assert_eq!(sent, mode);
        assert_eq!(&bytes[7..10], [0x36, 0x01, 0x00]);
    }
}

#[test]
fn unknown_commands_are_read_and_acknowledged_with_their_number() {
    let known = COMMAND_LONG_DATA {
        command: MavCmd::MAV_CMD_REQUEST_MESSAGE,
        param1: 3.0,
        target_system: 1,
        target_component: 42,
        ..COMMAND_LONG_DATA::default()
    };
    let mut payload = sent(&MavMessage::COMMAND_LONG(known))[V2_HEADER..].to_vec();
    payload[COMMAND_AT..COMMAND_AT + 2].copy_from_slice(&42_650_u16.to_le_bytes());
    let mut frame = vec![0xFD, 32, 0, 0, 0, 255, 190, 76, 0, 0];
    frame.extend(&payload[..32]);
    let crc = mavlink::calculate_crc(&frame[1..], COMMAND_LONG_DATA::EXTRA_CRC);
    frame.extend(crc.to_le_bytes());
    let messages = parsed(&frame);
    let params = [3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(
        messages,
        [In {
            from: (255, 190),
            to: (1, 42),
            request: Request::Command(Command { number: 42_650, params })
        }]
    );

    let bytes = writer(Versions::Two).bytes(&ack(42_650), None, IntegerEncoding::Bytewise).unwrap();
    assert_eq!(bytes[V2_HEADER..V2_HEADER + 10], [0x9A, 0xA6, 3, 0, 0, 0, 0, 0, 255, 190]);
    let bytes = writer(Versions::One).bytes(&ack(42_650), None, IntegerEncoding::Bytewise).unwrap();
    assert_eq!((bytes[1], &bytes[V1_HEADER..V1_HEADER + 3]), (3, &[0x9A, 0xA6, 3][..]));
}

#[test]
fn integers_have_the_encoding_of_the_station() {
    let content = Content::Parameter {
        name: "SIXTEEN_LETTERS_".into(),
        number: Number::Int32(-12),
        count: 26,
        index: 3,
    };
    let out = Out { component: 42, content };
    for (encoding, value) in [
        (IntegerEncoding::Bytewise, (-12_i32).to_le_bytes()),
        (IntegerEncoding::Cast, (-12.0_f32).to_le_bytes()),
    ] {
        let bytes = writer(Versions::Two).bytes(&out, None, encoding).unwrap();
        let payload = &bytes[V2_HEADER..];
        assert_eq!(
            (&payload[..4], &payload[4..8], payload[24]),
            (&value[..], &[26, 0, 3, 0][..], 6)
        );
        assert_eq!(&payload[8..24], b"SIXTEEN_LETTERS_");
    }
}

#[test]
fn with_a_key_only_signed_messages_are_accepted_and_each_once() {
    let mut signed = Writer::new(255, Versions::Auto, key(1));
    let request = Out {
        component: 190,
        content: Content::from(MavMessage::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA {
            target_system: 1,
            target_component: 42,
        })),
    };
    let bytes =
        signed.bytes(&request, Some(MavlinkVersion::V1), IntegerEncoding::Bytewise).unwrap();
    let mut parser = Parser::new(key(1));
    let mut take = |bytes: &[u8]| {
        parser.feed(bytes);
        parser.message().unwrap().map(|(_, message)| message.request)
    };
    assert_eq!(take(&bytes), Ok(Request::ParameterList));
    assert_eq!(
        take(&bytes),
        Err(Refused::Signature(Rejection::Old)),
        "a message must not be accepted twice"
    );
    let wrong = Writer::new(255, Versions::Auto, key(2))
        .bytes(&request, None, IntegerEncoding::Bytewise)
        .unwrap();
    assert_eq!(take(&wrong), Err(Refused::Signature(Rejection::OtherKey)));
    let unsigned = writer(Versions::Two).bytes(&request, None, IntegerEncoding::Bytewise).unwrap();
    assert_eq!(take(&unsigned), Err(Refused::Signature(Rejection::Unsigned)));
    let old = writer(Versions::One).bytes(&request, None, IntegerEncoding::Bytewise).unwrap();
    assert_eq!(take(&old), Err(Refused::Signature(Rejection::Unsigned)));
    // A radio puts its status between the messages, and has no key.
    let status = RADIO_STATUS_DATA { txbuf: 42, ..RADIO_STATUS_DATA::default() };
    let radio = sent(&MavMessage::RADIO_STATUS(status));
    assert_eq!(take(&radio), Ok(Request::Radio { free_percent: 42 }));
}

#[test]
fn messages_are_found_between_other_bytes_and_in_pieces() {
    let message = sent(&MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()));
    let rubbish: Vec<u8> =
        (0..600_u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let bytes =
        [&rubbish[..], &message, &[0xFD, 3, 0], &message, &rubbish, &message, &[0; 300]].concat();
    let mut parser = Parser::new(None);
    let mut found = 0;
    for byte in bytes {
        parser.feed(&[byte]);
        found += std::iter::from_fn(|| parser.message()).filter(Result::is_ok).count();
    }
    assert_eq!(found, 3);
}
