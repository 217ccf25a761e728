//! Messages for ground stations, and their recipients.

use crate::message::Out;
use crate::number::Custom;
use crate::queue::Class;
use dronecan_host::NodeId;

/// A ground station, or what leads to some.
pub type PeerId = u32;

/// Who asks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Asker {
    pub peer: PeerId,
    /// System and component.
    pub from: (u8, u8),
    /// How it writes integers.
    pub custom: Custom,
}

/// To whom a message goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum To {
    All,
    One(PeerId),
}

/// What is to be put into the queues of ground stations.
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
    /// The node is gone: its last status is no news.
    Forget {
        node: NodeId,
    },
}
