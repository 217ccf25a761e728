//! Tests of the bytes of messages in both directions.

use super::*;
use crate::number::IntegerEncoding;
use crate::signing::{Rejection, Signer, Signing};
use mavlink::MavlinkVersion;
use mavlink::dialects::common::RADIO_STATUS_DATA;
use std::cell::RefCell;
use std::rc::Rc;

/// Header length of a frame of version 2: magic, length, two flags, sequence, system, component,
/// three bytes of message ID.
const V2_HEADER: usize = 10;

fn writer(versions: Versions) -> Writer {
    Writer::new(1, versions, None)
}

fn heartbeat() -> Out {
    Out { component: 126, content: Content::from(MavMessage::HEARTBEAT(HEARTBEAT_DATA::default())) }
}

fn status(mode: u8) -> Out {
    let data = UAVCAN_NODE_STATUS_DATA { uptime_sec: 5, ..UAVCAN_NODE_STATUS_DATA::default() };
    Out { component: 42, content: Content::Status { data, mode } }
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

/// `tests/clients/test_bridge_rights.py` has the signed ones.
#[test]
fn with_a_key_unsigned_messages_of_both_versions_are_refused_and_a_radio_needs_none() {
    let signer = Signer::new(Rc::new(RefCell::new(Signing::new([1; 32]))), 0);
    let mut parser = Parser::new(Some(signer));
    let radio = Content::from(MavMessage::RADIO_STATUS(RADIO_STATUS_DATA::default()));
    let radio = Out { component: 68, content: radio };
    let unsigned = Err(Refused::Signature(Rejection::Unsigned));
    for (version, out, expected) in [
        (Versions::One, heartbeat(), unsigned.clone()),
        (Versions::Two, heartbeat(), unsigned),
        (Versions::Two, radio, Ok(Request::Radio { free_percent: 0 })),
    ] {
        parser.feed(&writer(version).bytes(&out, None, IntegerEncoding::Bytewise).unwrap());
        let request = parser.message().unwrap().map(|(_, message)| message.request);
        assert_eq!(request, expected, "{out:?}");
    }
}
