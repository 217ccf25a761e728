//! Target `host`: input that host programs get from other programs: SLCAN text in both directions,
//! datagrams of the multicast bus, frames as text, identifiers, transfers and their messages.
//! Decoded values must encode, and decode to the same values again.
//!
//! The first byte of the input selects one of them.

use std::time::Duration;

use dronecan_host::draft::id::TransferType;
use dronecan_host::draft::{self, Route};
use dronecan_host::mcast::datagram;
use dronecan_host::slcan::{self, Command, Reply};
use dronecan_host::{
    Assembler, CanId, DataType, Frame, Id, Message, NodeId, Observation, Observer, Outcome,
    Transfer, TransferId, crc, split,
};

/// Runs an input.
pub fn run(input: &[u8]) {
    let Some((&kind, rest)) = input.split_first() else { return };
    match kind % 7 {
        0 => commands(rest),
        1 => replies(rest),
        2 => datagrams(rest),
        3 => text(rest),
        4 => frames(rest),
        5 => payload(rest),
        _ => names(rest),
    }
}

/// Commands of a client to an adapter.
fn commands(bytes: &[u8]) {
    let mut lines = slcan::Lines::default();
    let mut replies = slcan::Replies::default();
    for &byte in bytes {
        if let Some(Ok(Command::Send(frame))) = lines.push(byte) {
            let line = slcan::line(&frame, Some(59_999));
            let last = line.iter().filter_map(|&byte| replies.push(byte)).last();
            assert_eq!(last, Some(Reply::Received(frame)));
        }
    }
    // After any input the next line must be parsed.
    lines.push(b'\r');
    let command = b"O\r".iter().filter_map(|&byte| lines.push(byte)).last();
    assert_eq!(command, Some(Ok(Command::Open)));
}

/// Replies of an adapter to a client.
fn replies(bytes: &[u8]) {
    let mut replies = slcan::Replies::default();
    let mut lines = slcan::Lines::default();
    for &byte in bytes {
        if let Some(Reply::Received(frame)) = replies.push(byte) {
            let command =
                slcan::line(&frame, None).iter().filter_map(|&byte| lines.push(byte)).last();
            assert_eq!(command, Some(Ok(Command::Send(frame))));
        }
    }
    replies.push(b'\r');
    assert_eq!(b"z\r".iter().filter_map(|&byte| replies.push(byte)).last(), Some(Reply::Done));
}

/// The datagram unchanged, and with a valid magic number and CRC.
fn datagrams(bytes: &[u8]) {
    let check = |bytes: &[u8]| {
        if let Ok(frame) = datagram::decode(bytes) {
            let again = datagram::encode(&frame).expect("no remote frame");
            assert_eq!(datagram::decode(&again), Ok(frame));
        }
    };
    check(bytes);
    let mut right = bytes.to_vec();
    if let [m0, m1, c0, c1, rest @ ..] = right.as_mut_slice() {
        [*m0, *m1] = 0x2934u16.to_le_bytes();
        [*c0, *c1] = crc::feed(crc::INITIAL, rest).to_le_bytes();
        check(&right);
    }
}

/// Frames as text in candump's form, one a line.
fn text(bytes: &[u8]) {
    for line in String::from_utf8_lossy(bytes).lines() {
        if let Ok(frame) = line.parse::<Frame>() {
            assert_eq!(frame.to_string().parse(), Ok(frame));
        }
    }
}

/// A message must be printable, and must encode to bytes that decode to the same message.
fn check(transfer: &Transfer) {
    let message = Message::decode(transfer);
    assert!(!message.to_string().is_empty() && !message.name().is_empty());
    let Some((data_type, payload)) = message.encode() else { return };
    assert_eq!(DataType::of(transfer.id), Some(data_type));
    let again = Message::decode(&Transfer { payload: payload.clone(), ..transfer.clone() });
    // Compares the text: a message with NaN does not equal itself.
    assert_eq!(again.encode(), Some((data_type, payload)), "{message}");
    assert_eq!(again.to_string(), message.to_string());
}

/// Frames in any order. Each has an identifier, a length, the time since the previous one, and
/// data.
fn frames(mut bytes: &[u8]) {
    let (mut assembler, mut observer) = (Assembler::new(), Observer::new());
    let mut at = Duration::ZERO;
    while let [a, b, c, d, len, wait, rest @ ..] = bytes {
        let (data, rest) = rest.split_at(usize::from(len % 9).min(rest.len()));
        let id = u32::from_be_bytes([a & 0x1F, *b, *c, *d]);
        at += Duration::from_millis(u64::from(*wait) * 10);
        if let Some(can_id) = CanId::parse(id) {
            assert_eq!(can_id.build(), id);
        }
        if let Some(can_id) = draft::CanId::parse(id) {
            assert_eq!(can_id.build(), id);
        }
        if let Observation::Complete(transfer) = observer.push(id, data, at) {
            assert!(
                !transfer.to_string().is_empty()
                    && !transfer.name().is_empty()
                    && !transfer.endpoints().is_empty()
            );
        }
        if let Outcome::Complete(transfer) = assembler.push(id, data, at) {
            check(&transfer);
        }
        bytes = rest;
    }
}

/// A payload of any type: an identifier, and the payload. Its frames must assemble to the same
/// payload.
fn payload(bytes: &[u8]) {
    /// Longest transfer of an unknown type.
    const MAX: usize = 512;
    let Some((id, payload)) = bytes.split_first_chunk::<4>() else { return };
    let id = u32::from_be_bytes(*id) & 0x1FFF_FFFF;
    draft_payload(id, payload);
    let Some(can_id) = CanId::parse(id) else { return };
    let transfer_id = TransferId::new(payload.len() as u8);
    check(&Transfer { id: can_id, transfer_id, payload: payload.to_vec(), frames: 1 });
    if payload.len() > 7 && (matches!(can_id, CanId::Anonymous { .. }) || payload.len() > MAX - 2) {
        return;
    }
    let seed = DataType::of(can_id).and_then(|known| known.seed).unwrap_or(0);
    let mut assembler = Assembler::new();
    let frames = split(payload, transfer_id, seed);
    let outcomes: Vec<_> =
        frames.iter().map(|data| assembler.push(id, data, Duration::ZERO)).collect();
    let whole =
        Transfer { id: can_id, transfer_id, payload: payload.to_vec(), frames: frames.len() };
    assert_eq!(outcomes.last(), Some(&Outcome::Complete(whole)));
    assert!(outcomes[..frames.len() - 1].iter().all(|outcome| *outcome == Outcome::Partial));
}

/// A payload in the draft of 2014, as a broadcast or as a request to a node.
fn draft_payload(id: u32, payload: &[u8]) {
    let Some(can_id) = draft::CanId::parse(id) else { return };
    let Some(other) = NodeId::new(if can_id.source.get() == 127 { 126 } else { 127 }) else {
        return;
    };
    let route = match can_id.transfer_type {
        TransferType::MessageBroadcast => Route::Broadcast,
        TransferType::MessageUnicast => Route::Unicast(other),
        TransferType::ServiceRequest => Route::Request(other),
        TransferType::ServiceResponse => Route::Response(other),
    };
    let (type_id, source, transfer_id) = (can_id.type_id, can_id.source, can_id.transfer_id);
    let transfer =
        draft::Transfer { type_id, source, route, transfer_id, payload: payload.to_vec() };
    let message = draft::Message::decode(&transfer);
    assert!(!message.to_string().is_empty() && !message.name().is_empty());
    if let Some((data_type, payload)) = message.encode() {
        let again = draft::Message::decode(&draft::Transfer {
            payload: payload.clone(),
            ..transfer.clone()
        });
        assert_eq!(again.encode(), Some((data_type, payload)), "{message}");
    }
    if payload.len() <= draft::transfer::PAYLOAD_MAX {
        let seed = draft::DataType::of(type_id, can_id.transfer_type).and_then(|known| known.seed);
        let mut assembler = draft::Assembler::new();
        let frames = transfer.split(seed.unwrap_or(0)).into_iter();
        let outcomes = frames.filter_map(|frame| match frame.id {
            Id::Extended(id) => Some(assembler.push(id, frame.data(), Duration::ZERO)),
            Id::Standard(_) => None,
        });
        assert_eq!(outcomes.last(), Some(draft::Outcome::Complete(transfer)));
    }
}

/// Names of types in the user's notation.
fn names(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    for known in DataType::by_name(&text) {
        assert!(DataType::by_name(known.name).contains(&known));
    }
}
