//! Target `bridge`: bytes from ground stations, frames from the bus, and time.
//!
//! The lower two bits of a step's first byte are its kind: 0 bytes of a stream, their number in the
//! upper six bits; 1 a frame of the bus; 2 a MAVLink message with a valid CRC; 3 time. The bridge
//! must send only valid CAN frames and valid MAVLink messages. At the end it must report a node
//! that appears.

use std::collections::BTreeSet;
use std::time::Duration;

use bridge::core::Bridge;
use bridge::message::{Content, Parser, Versions, Writer};
use bridge::number::IntegerEncoding;
use bridge::post::{Asker, Post};
use bridge::state::{Rights, Settings};
use dronecan_host::{CanId, Frame, NodeId, NodeStatus, TransferId, split, types};

/// MAVLink system of the bridge and all nodes, component of the bridge, its node ID.
const SYSTEM: u8 = 1;
const COMPONENT: u8 = 101;
const NODE: u8 = 126;

struct Rig {
    bridge: Bridge,
    parser: Parser,
    writer: Writer,
    reader: Parser,
    now: Duration,
    sequence: u8,
}

impl Rig {
    fn new() -> Rig {
        let settings = Settings {
            system: SYSTEM,
            component: COMPONENT,
            node: NodeId::new(NODE).expect("a node ID"),
            unique_id: [7; 16],
            info_interval: Duration::from_secs(10),
            autosave: Some(Duration::from_secs(2)),
            rights: Rights { change: true, can: true },
            tunnels: vec![
                "120:/x".parse().expect("a tunnel"),
                "121:/y,broadcast=0x55".parse().expect("a tunnel"),
            ],
            hidden: BTreeSet::new(),
            epoch_us: 0,
        };
        Rig {
            bridge: Bridge::new(settings),
            parser: Parser::new(None),
            writer: Writer::new(SYSTEM, Versions::Auto, None),
            reader: Parser::new(None),
            now: Duration::ZERO,
            sequence: 0,
        }
    }

    /// Feeds bytes of a ground station. A message needs at least one byte.
    fn feed(&mut self, bytes: &[u8]) {
        self.parser.feed(bytes);
        let mut messages = 0;
        while let Some(message) = self.parser.message() {
            messages += 1;
            assert!(messages <= bytes.len() + 300, "more messages than bytes");
            if let Ok((_, message)) = message {
                let asker =
                    Asker { peer: 1, from: message.from, encoding: IntegerEncoding::Bytewise };
                self.bridge.message(self.now, asker, message);
            }
        }
        self.check();
    }

    /// Checks the frames and messages that the bridge sends.
    fn check(&mut self) {
        for frame in self.bridge.frames.drain(..) {
            assert!(frame.dlc <= 8, "{frame}");
            assert_eq!(frame.to_string().parse(), Ok(frame));
        }
        for post in self.bridge.take_posts() {
            let (Post::Message { out, .. } | Post::Status { out, .. }) = post else { continue };
            let bytes = self
                .writer
                .bytes(&out, None, IntegerEncoding::Bytewise)
                .expect("it exists in version 2");
            self.reader.feed(&bytes);
            let read = self.reader.message();
            assert!(
                matches!(&read, Some(Ok((_, message))) if message.from == (SYSTEM, out.component)),
                "{out:?}"
            );
            assert!(self.reader.message().is_none(), "{out:?}");
        }
        self.bridge.take_log();
    }

    fn pass(&mut self, ms: u64) {
        self.now += Duration::from_millis(ms);
        self.bridge.poll(self.now);
        self.check();
    }

    fn frame(&mut self, id: u32, data: &[u8]) {
        self.bridge.frame(self.now, &Frame::extended(id, data));
        self.check();
    }
}

/// Messages from ground stations to the bridge: message ID, its CRC_EXTRA, and length of the
/// payload (message definitions `common` of MAVLink).
const MESSAGES: [(u32, u8, u8); 9] = [
    (0, 50, 9),
    (20, 214, 20),
    (21, 159, 2),
    (23, 168, 23),
    (75, 158, 35),
    (76, 152, 33),
    (110, 84, 254),
    (386, 132, 16),
    (388, 8, 37),
];

/// A message of version 2. Its payload may be truncated.
fn message(which: u8, sequence: u8, payload: &[u8]) -> Vec<u8> {
    const STATION: [u8; 2] = [255, 190];
    let (number, extra, len) = MESSAGES[usize::from(which) % MESSAGES.len()];
    let payload = &payload[..payload.len().min(len.into())];
    let [n0, n1, n2, _] = number.to_le_bytes();
    let mut bytes = vec![0xFD, payload.len() as u8, 0, 0, sequence];
    bytes.extend(STATION);
    bytes.extend([n0, n1, n2]);
    bytes.extend(payload);
    let crc = bytes[1..].iter().chain([&extra]).fold(0xFFFF, |crc, byte| crc_x25(crc, *byte));
    bytes.extend(crc.to_le_bytes());
    bytes
}

/// Adds a byte to MAVLink's CRC (X.25).
fn crc_x25(crc: u16, byte: u8) -> u16 {
    (0..8).fold(crc ^ u16::from(byte), |crc, _| crc >> 1 ^ if crc & 1 != 0 { 0x8408 } else { 0 })
}

/// Runs an input.
pub fn run(mut input: &[u8]) {
    let mut rig = Rig::new();
    rig.bridge.joined(rig.now, 1);
    rig.check();
    while let [first, rest @ ..] = input {
        let number = usize::from(first >> 2);
        input = match (first & 3, rest) {
            (0, rest) => {
                let (bytes, rest) = rest.split_at(number.min(rest.len()));
                rig.feed(bytes);
                rest
            }
            (1, [a, b, c, d, rest @ ..]) => {
                let (data, rest) = rest.split_at((number % 9).min(rest.len()));
                rig.frame(u32::from_be_bytes([a & 0x1F, *b, *c, *d]), data);
                rest
            }
            (2, rest) => {
                let (payload, rest) = rest.split_at(number.min(rest.len()));
                let (which, payload) = payload.split_first().unwrap_or((&0, &[]));
                rig.sequence = rig.sequence.wrapping_add(1);
                let bytes = message(*which, rig.sequence, payload);
                rig.feed(&bytes);
                rest
            }
            (3, rest) => {
                rig.pass(1 << (number % 12));
                rest
            }
            _ => break,
        };
    }

    // An hour later a node appears, with a new ID or one that was offline.
    rig.pass(3_600_000);
    rig.pass(1000);
    let source = NodeId::new(125).expect("a node ID");
    let id = CanId::Message { priority: 24, type_id: types::NODE_STATUS.id, source }.build();
    let [status] = split(&NodeStatus::default().encode(), TransferId::new(0), 0)
        .try_into()
        .expect("one frame");
    rig.bridge.frame(rig.now, &Frame::extended(id, &status));
    let is_told = |post: &Post| {
        matches!(
            post,
            Post::Status { node, out }
                if *node == source && matches!(out.content, Content::Status { .. })
        )
    };
    let posts = rig.bridge.take_posts();
    assert!(posts.iter().any(is_told), "{posts:?}");
}
