//! The 29-bit CAN identifier of DroneCAN v0 and the node ID in it.
//!
//! ```text
//! message   : prio[28:24] type[23:8]                             0[7] source[6:0]
//! anonymous : prio[28:24] discriminator[23:10] type[9:8]         0[7] 0[6:0]
//! service   : prio[28:24] service[23:16] request[15] dest[14:8]  1[7] source[6:0]
//! ```
//! Source: DroneCAN specification, "CAN bus transport layer", section "CAN frame format".

use std::fmt;

const PRIORITY_SHIFT: u32 = 24;
const MESSAGE_TYPE_SHIFT: u32 = 8;
const DISCRIMINATOR_SHIFT: u32 = 10;
const ANONYMOUS_TYPE_SHIFT: u32 = 8;
const SERVICE_TYPE_SHIFT: u32 = 16;
const REQUEST_FLAG: u32 = 1 << 15;
const DESTINATION_SHIFT: u32 = 8;
const SERVICE_FLAG: u32 = 1 << 7;
const PRIORITY_MASK: u32 = 0x1F;
const NODE_MASK: u32 = 0x7F;

/// Length of a unique ID in bytes (HardwareVersion).
pub const UNIQUE_ID_LEN: usize = 16;

/// Node ID, 1 to 127. On the wire 0 means "no ID" and is not a `NodeId`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct NodeId(u8);

impl NodeId {
    /// `None` outside 1..=127.
    pub const fn new(id: u8) -> Option<NodeId> {
        match id {
            1..=127 => Some(NodeId(id)),
            _ => None,
        }
    }

    /// The number on the wire.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// The lowest seven bits of a field.
    pub(crate) fn from_field(field: u32) -> Option<NodeId> {
        NodeId::new((field & NODE_MASK) as u8)
    }
}

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// A parsed identifier. Priority: 0 is the most urgent, 31 the least.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CanId {
    /// Broadcast from a node with an ID.
    Message { priority: u8, type_id: u16, source: NodeId },
    /// Broadcast from a node without an ID. It can have types 0 to 3 only.
    Anonymous { priority: u8, type_id: u8, discriminator: u16 },
    /// Request to, or response from, one node.
    Service { priority: u8, service_id: u8, request: bool, destination: NodeId, source: NodeId },
}

impl CanId {
    /// Reads a 29-bit identifier. `None` for a service frame from or to node 0, which the dialect
    /// forbids.
    pub fn parse(id: u32) -> Option<CanId> {
        let priority = (id >> PRIORITY_SHIFT & PRIORITY_MASK) as u8;
        let source = NodeId::from_field(id);
        if id & SERVICE_FLAG != 0 {
            return Some(CanId::Service {
                priority,
                service_id: (id >> SERVICE_TYPE_SHIFT & 0xFF) as u8,
                request: id & REQUEST_FLAG != 0,
                destination: NodeId::from_field(id >> DESTINATION_SHIFT)?,
                source: source?,
            });
        }
        Some(match source {
            Some(source) => CanId::Message {
                priority,
                type_id: (id >> MESSAGE_TYPE_SHIFT & 0xFFFF) as u16,
                source,
            },
            None => CanId::Anonymous {
                priority,
                type_id: (id >> ANONYMOUS_TYPE_SHIFT & 0x3) as u8,
                discriminator: (id >> DISCRIMINATOR_SHIFT & 0x3FFF) as u16,
            },
        })
    }

    /// The 29-bit identifier. Values that are too large for their field are truncated.
    pub fn build(self) -> u32 {
        let priority_bits = |priority: u8| (u32::from(priority) & PRIORITY_MASK) << PRIORITY_SHIFT;
        match self {
            CanId::Message { priority, type_id, source } => {
                priority_bits(priority)
                    | u32::from(type_id) << MESSAGE_TYPE_SHIFT
                    | u32::from(source.0)
            }
            CanId::Anonymous { priority, type_id, discriminator } => {
                priority_bits(priority)
                    | (u32::from(discriminator) & 0x3FFF) << DISCRIMINATOR_SHIFT
                    | (u32::from(type_id) & 0x3) << ANONYMOUS_TYPE_SHIFT
            }
            CanId::Service { priority, service_id, request, destination, source } => {
                priority_bits(priority)
                    | u32::from(service_id) << SERVICE_TYPE_SHIFT
                    | if request { REQUEST_FLAG } else { 0 }
                    | u32::from(destination.0) << DESTINATION_SHIFT
                    | SERVICE_FLAG
                    | u32::from(source.0)
            }
        }
    }

    /// The sender; `None` if it is anonymous.
    pub fn source(self) -> Option<NodeId> {
        match self {
            CanId::Message { source, .. } | CanId::Service { source, .. } => Some(source),
            CanId::Anonymous { .. } => None,
        }
    }
}

/// "1", "anon" or "127>42": the source, and for a service the destination.
impl fmt::Display for CanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            CanId::Message { source, .. } => f.pad(&source.to_string()),
            CanId::Anonymous { .. } => f.pad("anon"),
            CanId::Service { destination, source, .. } => f.pad(&format!("{source}>{destination}")),
        }
    }
}
