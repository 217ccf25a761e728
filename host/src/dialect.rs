//! Finds the dialect of a frame.
//!
//! Every identifier is valid in v0, and almost every one in the draft. The data type decides: the known types of v0 and those of
//! the draft have no identifier in common, except anonymous frames of v0 and the draft's messages to one node, which none of its
//! types uses. So:
//!
//! 1. A frame of a known type of v0 is v0; an anonymous one only if its tail byte is that of a transfer of one frame.
//! 2. Else a frame of a known type of the draft is of the draft, if the draft allows its identifier.
//! 3. A frame of an unknown type is of the dialect of the last NodeStatus on the bus, and of v0 before the first.

use crate::types::{DataType, NODE_STATUS};
use crate::{Assembler, CanId, Message, NodeId, Outcome, Transfer, draft};
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

/// Finds the dialect of each frame on one bus, by the rule of the module.
#[derive(Clone, Copy, Debug, Default)]
pub struct Ear {
    /// That of the last NodeStatus.
    last_status: Dialect,
}

/// The upper bits of the tail byte of a transfer of one frame.
const WHOLE: u8 = 0b110;
const TRANSFER_ID_BITS: u32 = 5;
/// Data bytes of v0's NodeStatus with its tail byte, and those of the draft's, which see.
const STATUS_LEN: usize = 8;
const DRAFT_STATUS_LENS: [usize; 4] = [4, 6, 7, 8];

impl Ear {
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
            let is_whole = (id.index, id.last, id.transfer_type) == (0, true, draft::TransferType::MessageBroadcast);
            if *known == draft::types::NODE_STATUS && is_whole && DRAFT_STATUS_LENS.contains(&data.len()) {
                self.last_status = Dialect::Draft;
            }
            return Dialect::Draft;
        }
        self.last_status
    }
}

/// A transfer of either dialect with its meaning.
#[derive(Clone, Debug, PartialEq)]
pub enum Said {
    V0(Transfer, Message),
    Draft(draft::Transfer, draft::Message),
}

impl Said {
    pub fn dialect(&self) -> Dialect {
        match self {
            Said::V0(..) => Dialect::V0,
            Said::Draft(..) => Dialect::Draft,
        }
    }

    /// Sender, where it has an identity.
    pub fn source(&self) -> Option<NodeId> {
        match self {
            Said::V0(transfer, _) => transfer.id.source(),
            Said::Draft(transfer, _) => Some(transfer.source),
        }
    }

    /// "1", "anon" or "127>42": the source, and the destination if it is one node.
    pub fn who(&self) -> String {
        match self {
            Said::V0(transfer, _) => transfer.id.to_string(),
            Said::Draft(transfer, _) => transfer.who(),
        }
    }

    /// Name of its type, with the direction of a service: "GetNodeInfo request", "draft.NodeStatus".
    pub fn name(&self) -> String {
        match self {
            Said::V0(_, message) => message.name(),
            Said::Draft(_, message) => message.name(),
        }
    }
}

/// The message: "ArrayCommand id 1 unitless +0.50".
impl fmt::Display for Said {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Said::V0(_, message) => message.fmt(f),
            Said::Draft(_, message) => message.fmt(f),
        }
    }
}

/// What a frame shows an observer.
#[derive(Clone, Debug, PartialEq)]
pub enum Heard {
    /// A transfer is whole.
    Said(Said),
    /// A part, more to come.
    Partial,
    /// Not a valid part of anything in its dialect; the text says why.
    Invalid(&'static str),
}

/// Reassembles the transfers of all nodes on a bus, in either dialect.
#[derive(Default)]
pub struct Observer {
    ear: Ear,
    v0: Assembler,
    draft: draft::Assembler,
}

impl Observer {
    /// An observer that has seen no frame.
    pub fn new() -> Observer {
        Observer::default()
    }

    /// Takes an extended data frame that ended at `at`, counted from any moment that stays the same.
    pub fn push(&mut self, id: u32, data: &[u8], at: Duration) -> Heard {
        match self.ear.dialect(id, data) {
            Dialect::V0 => match self.v0.push(id, data, at) {
                Outcome::Complete(transfer) => {
                    let message = Message::decode(&transfer);
                    Heard::Said(Said::V0(transfer, message))
                }
                Outcome::Partial => Heard::Partial,
                Outcome::Invalid(why) => Heard::Invalid(why),
            },
            Dialect::Draft => match self.draft.push(id, data, at) {
                draft::Outcome::Complete(transfer) => {
                    let message = draft::Message::decode(&transfer);
                    Heard::Said(Said::Draft(transfer, message))
                }
                draft::Outcome::Partial => Heard::Partial,
                draft::Outcome::Invalid(why) => Heard::Invalid(why),
            },
        }
    }
}

/// Source, if it is not anonymous, and name of the type of an identifier in a dialect. `None` for an identifier that the dialect
/// forbids.
pub fn announced(dialect: Dialect, id: u32) -> Option<(Option<NodeId>, String)> {
    match dialect {
        Dialect::V0 => CanId::parse(id).map(|id| (id.source(), crate::message::name_of(id))),
        Dialect::Draft => {
            draft::CanId::parse(id).map(|id| (Some(id.source), draft::message::name_of(id.type_id, id.transfer_type)))
        }
    }
}

#[cfg(test)]
#[path = "dialect_tests.rs"]
mod tests;
