//! Messages for ground stations, and their recipients.

use crate::message::Out;
use crate::number::IntegerEncoding;
use crate::queue::Class;
use dronecan_host::NodeId;

/// A peer of a channel: a ground station, or a link that leads to some.
pub type PeerId = u32;

/// The sender of a request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Asker {
    pub peer: PeerId,
    /// System and component.
    pub from: (u8, u8),
    /// Its encoding of integers.
    pub encoding: IntegerEncoding,
}

/// The recipients of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum To {
    All,
    One(PeerId),
}

/// An entry for the queues of ground stations.
#[derive(Clone, Debug, PartialEq)]
pub enum Post {
    Message {
        to: To,
        class: Class,
        out: Out,
    },
    Status {
        node: NodeId,
        out: Out,
    },
    /// The node is offline: its last status must not be sent.
    Forget {
        node: NodeId,
    },
}
