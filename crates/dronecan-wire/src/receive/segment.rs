//! A frame as a part of a transfer, and why the receiver drops one.

use super::Received;
use crate::bits::{Id, Tail};

/// A frame as a part of a transfer. [`read`](Self::read) makes a segment of a DroneCAN frame. A
/// program for another dialect can make segments of other frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segment<'a, K> {
    /// The type of the transfer.
    pub kind: K,
    /// Node ID of the sender, or 0 if the sender is anonymous.
    pub source: u8,
    /// Priority of the frame, 0 to 31. The response to a request has the same priority. A dialect
    /// may use the higher bits.
    pub priority: u8,
    /// The tail: the place of the frame in the transfer.
    pub tail: Tail,
    /// The payload bytes before the tail.
    pub payload: &'a [u8],
}

/// Why a frame or a transfer is dropped. Losses of transfers for this node come last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejection {
    /// The sender has this node's ID.
    OwnId,
    /// The sender is anonymous.
    Anonymous,
    /// A message or service that the node does not receive, or a service for another node.
    Unknown,
    /// The frame has no tail byte; it is a first frame with its toggle bit set, or too short for
    /// the CRC; or its transfer has several frames and must have one.
    Malformed,
    /// The program cannot take a request now. This crate never returns this value; it exists so
    /// that a program has one type for all reasons.
    Busy,
    /// A list ends within an entry, or has too many entries.
    Length,
    /// The CRC is wrong, or the sender began another transfer before this one was complete.
    Broken,
    /// There was no lane for the transfer, or another sender's transfer took its lane.
    Interleaved,
}

impl Rejection {
    /// True if a transfer for this node was lost.
    pub const fn is_loss(self) -> bool {
        matches!(self, Self::Broken | Self::Interleaved | Self::Length)
    }
}

impl<'a, K: Received> Segment<'a, K> {
    /// Reads a frame with an extended identifier, for the node with the ID `node`, or 0 if the node
    /// has no ID.
    pub fn read(id: Id, data: &'a [u8], node: u8) -> Result<Self, Rejection> {
        let source = id.source();
        let kind = if source == 0 {
            let kind = if id.is_service() {
                K::UNKNOWN
            } else {
                K::of_anonymous(id.anonymous_data_type(), node)
            };
            if kind == K::UNKNOWN {
                return Err(Rejection::Anonymous);
            }
            kind
        } else if source == node {
            return Err(Rejection::OwnId);
        } else if !id.is_service() {
            K::of_message(id.data_type())
        } else if node != 0 && id.is_request_to(node) {
            K::of_request(id.service())
        } else if K::TAKES_RESPONSES && node != 0 && id.is_response_to(node) {
            K::of_response(id.service())
        } else {
            return Err(Rejection::Unknown);
        };
        if kind == K::UNKNOWN {
            return Err(Rejection::Unknown);
        }
        let (&tail, payload) = data.split_last().ok_or(Rejection::Malformed)?;
        Ok(Self { kind, source, priority: id.priority(), tail: Tail(tail), payload })
    }
}
