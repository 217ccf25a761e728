//! What clients and servers need: responses, anonymous requests for a node ID, and payloads of more
//! than 255 bytes.

use super::*;
use crate::receive::Transfer;
use crate::{Data, LongSender, Tail};

/// This node, and the one that it asks.
const NODE: u8 = 42;
const SERVER: u8 = 10;

/// The signature of file.Read.
const FILE_READ: u64 = 0x8DCD_CA93_9F33_F678;

/// A client of file.Read that also answers GetNodeInfo, and allocates node IDs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Unknown,
    Lights,
    Allocation,
    GetNodeInfo,
    NodeInfo,
    ReadFile,
}

impl Received for Kind {
    const UNKNOWN: Self = Self::Unknown;
    const TAKES_RESPONSES: bool = true;
    const LANE_FOR_EACH_TYPE: bool = true;

    fn of_message(data_type: u16) -> Self {
        if data_type == types::LIGHTS_COMMAND.id { Self::Lights } else { Self::Unknown }
    }

    fn of_anonymous(data_type: u8, _node: u8) -> Self {
        if u16::from(data_type) == types::ALLOCATION.id & 3 {
            Self::Allocation
        } else {
            Self::Unknown
        }
    }

    fn of_request(service: u8) -> Self {
        if service == types::GET_NODE_INFO.id { Self::GetNodeInfo } else { Self::Unknown }
    }

    fn of_response(service: u8) -> Self {
        match service {
            id if id == types::GET_NODE_INFO.id => Self::NodeInfo,
            id if id == types::FILE_READ.id => Self::ReadFile,
            _ => Self::Unknown,
        }
    }

    fn is_request(self) -> bool {
        self == Self::GetNodeInfo
    }

    fn is_multi_frame(self) -> bool {
        !matches!(self, Self::GetNodeInfo | Self::Allocation)
    }

    fn entry_len(self) -> u8 {
        if self == Self::Lights { 3 } else { 0 }
    }

    fn seed(self) -> u16 {
        match self {
            Self::NodeInfo => types::GET_NODE_INFO.seed,
            Self::ReadFile => types::FILE_READ.seed,
            Self::Lights => types::LIGHTS_COMMAND.seed,
            _ => 0,
        }
    }
}

type Long = LongReceiver<Kind, 1, 1, 400>;

fn read(frame: &Frame) -> Result<Segment<'_, Kind>, Rejection> {
    Segment::read(Id::from_bytes(frame.id.to_be_bytes()), &frame.data, NODE)
}

/// The transfer that the frames complete.
fn received(receiver: &mut Long, frames: &[Frame]) -> Option<Transfer<Kind, 400, u16>> {
    let mut complete = None;
    for frame in frames {
        match receiver.accept(read(frame).unwrap(), 3, 0) {
            Verdict::More => assert!(complete.is_none()),
            Verdict::Message(transfer) | Verdict::Request(transfer) => complete = Some(*transfer),
            Verdict::Rejected(rejection) => panic!("{rejection:?}"),
        }
    }
    complete
}

fn response(service: u8, to: u8) -> u32 {
    u32::from_be_bytes(Id::response(30, service, to, SERVER).to_bytes())
}

/// The longest response of file.Read has 258 bytes, that of GetNodeInfo 377.
#[test]
fn responses_of_every_length_up_to_400_bytes_are_received_whole() {
    let mut receiver = Long::long(CompleteFirst::NEW);
    let bytes: Vec<u8> = (0..400).map(|n| (n * 37 + 5) as u8).collect();
    for len in 0..=400 {
        let id = response(types::FILE_READ.id, NODE);
        let frames = golden::transfer(id, FILE_READ, (len % 32) as u8, &bytes[..len]);
        let transfer = received(&mut receiver, &frames).unwrap();
        assert_eq!((transfer.kind, transfer.source), (Kind::ReadFile, SERVER));
        assert_eq!((transfer.transfer_id(), transfer.len()), ((len % 32) as u8, len as u16));
        assert_eq!(transfer.payload(), &bytes[..len], "{len}");
        assert_eq!(transfer.payload_from(2), (len >= 2).then(|| &bytes[2..len]), "{len}");
    }
}

#[test]
fn a_long_payload_that_was_not_kept_whole_has_its_length() {
    let mut receiver = LongReceiver::<Kind, 1, 1, 8>::long(CompleteFirst::NEW);
    let frames = golden::transfer(response(1, NODE), golden::GET_NODE_INFO, 0, &[7; 377]);
    let mut lens = vec![];
    for frame in &frames {
        if let Verdict::Message(transfer) = receiver.accept(read(frame).unwrap(), 0, 0) {
            lens.push((transfer.kind, transfer.len(), transfer.payload().to_vec()));
        }
    }
    assert_eq!(lens, [(Kind::NodeInfo, 377, vec![7; 8])]);
}

/// Entry 200 would begin behind the first 255 bytes.
#[test]
fn a_long_receiver_keeps_the_entry_of_a_list_for_this_node() {
    let payload: Vec<u8> = (0..=255).flat_map(|id| [id, 0xA0, id ^ 0xFF]).collect();
    let frames = golden::transfer(0x1004_390A, golden::LIGHTS_COMMAND, 0, &payload[..600]);
    let transfer = received(&mut Long::long(CompleteFirst::NEW), &frames).unwrap();
    assert_eq!((transfer.kind, transfer.payload()), (Kind::Lights, &[3, 0xA0, 0xFC][..]));
}

#[test]
fn a_response_to_another_node_or_of_an_unknown_service_is_dropped() {
    let frame = |service, to| golden::frame(response(service, to), &[0xC0]);
    assert_eq!(read(&frame(1, NODE)).map(|segment| segment.kind), Ok(Kind::NodeInfo));
    assert_eq!(read(&frame(1, NODE + 1)), Err(Rejection::Unknown));
    assert_eq!(read(&frame(5, NODE)), Err(Rejection::Unknown));
    let anonymous = Segment::<Kind>::read(Id::response(30, 1, 0, SERVER), &[0xC0], 0);
    assert_eq!(anonymous, Err(Rejection::Unknown), "a node without an ID asked nobody");
    let request = golden::frame(0x1E01_AA8A, &[0xC0]);
    assert_eq!(read(&request).map(|segment| segment.kind), Ok(Kind::GetNodeInfo));
}

/// An allocator of node IDs receives the requests of nodes that have none.
#[test]
fn an_anonymous_message_is_received_with_source_0() {
    let id = u32::from_be_bytes(Id::anonymous(30, types::ALLOCATION.id, 0x1234).to_bytes());
    let frame = golden::frame(id, &[0, 1, 2, 3, 4, 5, 6, 0xC0]);
    let transfer = received(&mut Long::long(CompleteFirst::NEW), &[frame]).unwrap();
    assert_eq!((transfer.kind, transfer.source), (Kind::Allocation, 0));
    assert_eq!(transfer.payload(), [0, 1, 2, 3, 4, 5, 6]);
}

#[test]
fn the_sender_splits_payloads_of_every_length_up_to_400_bytes() {
    let bytes: Vec<u8> = (0..400).map(|n| (n * 37 + 5) as u8).collect();
    for len in 0..=400 {
        let payload = &bytes[..len];
        let (mut sender, mut frames) = (LongSender::long(), vec![]);
        sender.begin(len as u16, 9, types::FILE_READ.seed);
        while sender.is_busy() {
            let mut data = Data::EMPTY;
            while !sender.is_ready() {
                sender.step(payload, &mut data);
            }
            frames.push(golden::frame(0x1E30_8AAA, data.as_slice()));
            sender.sent();
        }
        let expected = golden::transfer(0x1E30_8AAA, FILE_READ, 9, payload);
        assert_eq!(golden::text(&frames), golden::text(&expected), "{len} bytes");
        assert!(Tail(*frames[0].data.last().unwrap()).is_start());
    }
}
