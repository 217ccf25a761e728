//! Finds the dialect of a frame.
//!
//! Every identifier is valid in v0, and almost every one in the draft. The data type decides: no
//! identifier belongs to a known type of v0 and to one of the draft, with two exceptions: anonymous
//! frames of v0, and the draft's messages to one node, which none of its types uses. The rules:
//!
//! 1. A frame of a known type of v0 is v0. An anonymous frame must also have the tail byte of a
//!    single-frame transfer.
//! 2. Otherwise a frame of a known type of the draft is draft, if the draft allows its identifier.
//! 3. A frame of an unknown type has the dialect of the last NodeStatus on the bus; before the
//!    first one it is v0.

use crate::sessions::Outcome;
use crate::types::{DataType, NODE_STATUS};
use crate::{Assembler, CanId, Message, NodeId, Transfer, draft};
use std::fmt;
use std::time::Duration;

/// A dialect.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Dialect {
    /// DroneCAN, which was UAVCAN v0.
    #[default]
    V0,
    /// The draft of 2014.
    Draft,
}

impl Dialect {
    /// The other dialect.
    pub fn other(self) -> Dialect {
        match self {
            Dialect::V0 => Dialect::Draft,
            Dialect::Draft => Dialect::V0,
        }
    }
}

impl fmt::Display for Dialect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Dialect::V0 => "v0",
            Dialect::Draft => "draft",
        })
    }
}

/// Finds the dialect of each frame on one bus, by the module's rules.
#[derive(Clone, Copy, Debug, Default)]
pub struct DialectFinder {
    /// Dialect of the last NodeStatus.
    last_status: Dialect,
}

/// The upper bits of the tail byte of a single-frame transfer.
const WHOLE: u8 = 0b110;
const TRANSFER_ID_BITS: u32 = 5;
/// Data lengths of v0's NodeStatus with its tail byte, and of the draft's NodeStatus (see there).
const STATUS_LEN: usize = 8;
const DRAFT_STATUS_LENS: [usize; 4] = [4, 6, 7, 8];

impl DialectFinder {
    /// The dialect of an extended data frame.
    pub fn dialect(&mut self, id: u32, data: &[u8]) -> Dialect {
        let is_whole = data.last().is_some_and(|tail| tail >> TRANSFER_ID_BITS == WHOLE);
        if let Some(id) = CanId::parse(id)
            && let Some(known) = DataType::of(id)
            && (is_whole || !matches!(id, CanId::Anonymous { .. }))
        {
            if *known == NODE_STATUS && is_whole && data.len() == STATUS_LEN {
                self.last_status = Dialect::V0;
            }
            return Dialect::V0;
        }
        if let Some(id) = draft::CanId::parse(id)
            && let Some(known) = draft::DataType::of(id.type_id, id.transfer_type)
        {
            let is_whole = (id.index, id.last, id.transfer_type)
                == (0, true, draft::TransferType::MessageBroadcast);
            if *known == draft::types::NODE_STATUS
                && is_whole
                && DRAFT_STATUS_LENS.contains(&data.len())
            {
                self.last_status = Dialect::Draft;
            }
            return Dialect::Draft;
        }
        self.last_status
    }
}

/// A decoded transfer of either dialect.
#[derive(Clone, Debug, PartialEq)]
pub enum Decoded {
    V0(Transfer, Message),
    Draft(draft::Transfer, draft::Message),
}

impl Decoded {
    pub fn dialect(&self) -> Dialect {
        match self {
            Decoded::V0(..) => Dialect::V0,
            Decoded::Draft(..) => Dialect::Draft,
        }
    }

    /// The sender; `None` if it is anonymous.
    pub fn source(&self) -> Option<NodeId> {
        match self {
            Decoded::V0(transfer, _) => transfer.id.source(),
            Decoded::Draft(transfer, _) => Some(transfer.source),
        }
    }

    /// "1", "anon" or "127>42": the source, and for a service the destination.
    pub fn endpoints(&self) -> String {
        match self {
            Decoded::V0(transfer, _) => transfer.id.to_string(),
            Decoded::Draft(transfer, _) => transfer.endpoints(),
        }
    }

    /// Name of the type, with the direction of a service: "GetNodeInfo request",
    /// "draft.NodeStatus".
    pub fn name(&self) -> String {
        match self {
            Decoded::V0(_, message) => message.name(),
            Decoded::Draft(_, message) => message.name(),
        }
    }
}

/// The message: "ArrayCommand id 1 unitless +0.50".
impl fmt::Display for Decoded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Decoded::V0(_, message) => message.fmt(f),
            Decoded::Draft(_, message) => message.fmt(f),
        }
    }
}

/// The result of a frame for an observer.
pub type Observation = Outcome<Decoded>;

/// Reassembles the transfers of all nodes on a bus, in either dialect.
#[derive(Default)]
pub struct Observer {
    dialects: DialectFinder,
    v0: Assembler,
    draft: draft::Assembler,
}

impl Observer {
    /// An observer that has received no frame.
    pub fn new() -> Observer {
        Observer::default()
    }

    /// Handles an extended data frame that ended at `at`. All times count from the same moment.
    pub fn push(&mut self, id: u32, data: &[u8], at: Duration) -> Observation {
        match self.dialects.dialect(id, data) {
            Dialect::V0 => self.v0.push(id, data, at).map(|transfer| {
                let message = Message::decode(&transfer);
                Decoded::V0(transfer, message)
            }),
            Dialect::Draft => self.draft.push(id, data, at).map(|transfer| {
                let message = draft::Message::decode(&transfer);
                Decoded::Draft(transfer, message)
            }),
        }
    }
}

/// Source (`None` if anonymous) and type name of an identifier in a dialect. `None` for an
/// identifier that the dialect forbids.
pub fn announced(dialect: Dialect, id: u32) -> Option<(Option<NodeId>, String)> {
    match dialect {
        Dialect::V0 => CanId::parse(id).map(|id| (id.source(), crate::message::name_of(id))),
        Dialect::Draft => draft::CanId::parse(id)
            .map(|id| (Some(id.source), draft::message::name_of(id.type_id, id.transfer_type))),
    }
}

#[cfg(test)]
#[path = "dialect_tests.rs"]
mod tests;
