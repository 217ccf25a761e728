//! Transfers of the draft: splits a payload into frames and reassembles frames.
//!
//! A frame of a broadcast has eight bytes of payload. In all other frames the first byte is the
//! destination, which leaves seven. A longer payload follows its CRC, little endian, and is split.
//! There is no toggle bit: the identifier counts the frames.
//!
//! Assembly invariants: only frame 0 opens or replaces a session. A frame that does not continue
//! its session closes it. Repeated transfer IDs are not filtered, because an observer shows every
//! frame.

use super::id::{CanId, INDEX_MAX, TransferId, TransferType};
use super::types::DataType;
use crate::sessions::{Part, Sessions};
use crate::{Frame, NodeId, crc};
use std::time::Duration;

/// Data bytes of a CAN frame.
const FRAME_DATA: usize = 8;
const CRC_LEN: usize = 2;
/// Longest payload: one frame for each index with seven bytes each, minus the CRC (transfer.hpp).
pub const PAYLOAD_MAX: usize = (INDEX_MAX as usize + 1) * (FRAME_DATA - 1) - CRC_LEN;
/// A transfer that is not complete this long after its start times out: five times the interval
/// that a receiver assumes for an unknown sender (transfer_receiver.cpp).
const TIMEOUT: Duration = Duration::from_secs(5);
/// A bit of the destination byte that is never set.
const DESTINATION_RESERVED: u8 = 1 << 7;

/// Recipients and purpose of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Route {
    /// A message to all nodes.
    Broadcast,
    /// A message to one node.
    Unicast(NodeId),
    /// A request to the serving node.
    Request(NodeId),
    /// A response to the requesting node.
    Response(NodeId),
}

impl Route {
    fn of(transfer_type: TransferType, destination: Option<NodeId>) -> Option<Route> {
        match transfer_type {
            TransferType::MessageBroadcast => Some(Route::Broadcast),
            TransferType::MessageUnicast => destination.map(Route::Unicast),
            TransferType::ServiceRequest => destination.map(Route::Request),
            TransferType::ServiceResponse => destination.map(Route::Response),
        }
    }

    /// The transfer type in the identifier.
    pub fn transfer_type(self) -> TransferType {
        match self {
            Route::Broadcast => TransferType::MessageBroadcast,
            Route::Unicast(_) => TransferType::MessageUnicast,
            Route::Request(_) => TransferType::ServiceRequest,
            Route::Response(_) => TransferType::ServiceResponse,
        }
    }

    /// The destination; `None` for a broadcast.
    pub fn destination(self) -> Option<NodeId> {
        match self {
            Route::Broadcast => None,
            Route::Unicast(node) | Route::Request(node) | Route::Response(node) => Some(node),
        }
    }
}

/// A complete transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Transfer {
    /// Data type ID, 0 to 1023.
    pub type_id: u16,
    pub source: NodeId,
    pub route: Route,
    pub transfer_id: TransferId,
    pub payload: Vec<u8>,
}

impl Transfer {
    /// Source, and destination if it is one node: "1", "127>42".
    pub fn endpoints(&self) -> String {
        match self.route.destination() {
            Some(destination) => format!("{}>{destination}", self.source),
            None => self.source.to_string(),
        }
    }

    /// Its frames, in order. `seed` is that of the data type; a single frame does not need it.
    /// Panics if the payload is longer than [`PAYLOAD_MAX`].
    pub fn split(&self, seed: u16) -> Vec<Frame> {
        assert!(self.payload.len() <= PAYLOAD_MAX, "a payload of {} bytes", self.payload.len());
        let destination = self.route.destination().map(NodeId::get);
        let room = FRAME_DATA - usize::from(destination.is_some());
        let mut stream = Vec::new();
        if self.payload.len() > room {
            stream.extend(crc::feed(seed, &self.payload).to_le_bytes());
        }
        stream.extend(&self.payload);
        let last = stream.len().div_ceil(room).saturating_sub(1);
        let frame = |index: usize| {
            let part = stream.chunks(room).nth(index).unwrap_or_default();
            let data: Vec<u8> = destination.iter().chain(part).copied().collect();
            let id = CanId {
                type_id: self.type_id,
                transfer_type: self.route.transfer_type(),
                source: self.source,
                index: index as u8,
                last: index == last,
                transfer_id: self.transfer_id,
            };
            Frame::extended(id.build(), &data)
        };
        (0..=last).map(frame).collect()
    }
}

/// The result of a frame.
pub type Outcome = crate::sessions::Outcome<Transfer>;

/// What the frames of a transfer have in common except for the transfer ID.
type Key = (u16, NodeId, Route);

/// Reassembles the transfers of all nodes on a bus, with one session for each sender, data type and
/// destination. Of incomplete transfers only the newest are kept.
pub struct Assembler {
    sessions: Sessions<Key>,
}

impl Default for Assembler {
    fn default() -> Assembler {
        Assembler::new()
    }
}

impl Assembler {
    /// An assembler without a session.
    pub fn new() -> Assembler {
        Assembler { sessions: Sessions::new(TIMEOUT, PAYLOAD_MAX) }
    }

    /// Handles an extended data frame that ended at `at`. All times count from the same moment.
    pub fn push(&mut self, id: u32, data: &[u8], at: Duration) -> Outcome {
        let Some(id) = CanId::parse(id) else {
            return Outcome::Invalid("forbidden identifier");
        };
        let (destination, bytes) = match data.split_first() {
            _ if !id.transfer_type.has_destination() => (None, data),
            None => return Outcome::Invalid("no destination"),
            Some((node, _)) if node & DESTINATION_RESERVED != 0 => {
                return Outcome::Invalid("no valid destination");
            }
            Some((node, bytes)) => (NodeId::new(*node), bytes),
        };
        let Some(route) = Route::of(id.transfer_type, destination) else {
            return Outcome::Invalid("no valid destination");
        };
        if destination == Some(id.source) {
            return Outcome::Invalid("to its own sender");
        }
        let key = (id.type_id, id.source, route);
        let transfer = |payload| Transfer {
            type_id: id.type_id,
            source: id.source,
            route,
            transfer_id: id.transfer_id,
            payload,
        };
        let part = Part {
            id: id.transfer_id.get(),
            place: id.index,
            is_full: data.len() == FRAME_DATA,
            is_last: id.last,
            bytes,
            at,
        };
        match (id.index, id.last) {
            (0, true) => {
                self.sessions.close(&key);
                Outcome::Complete(transfer(bytes.to_vec()))
            }
            (0, false) if !part.is_full => Outcome::Invalid("start frame that is not full"),
            (0, false) => {
                self.sessions.open(key, &part, 1);
                Outcome::Partial
            }
            _ => {
                let seed =
                    || DataType::of(id.type_id, id.transfer_type).and_then(|known| known.seed);
                let outcome = self.sessions.go_on(key, &part, id.index + 1, seed);
                outcome.map(|(payload, _)| transfer(payload))
            }
        }
    }
}
