//! The DroneCAN (UAVCAN v0) wire format: identifiers, transfers, and one file for each message that the node uses.
//!
//! Source: DroneCAN specification, chapters 3 and 4, and the DSDL files named in each module. All messages here fit in one
//! frame: up to seven bytes of payload and a tail byte.

pub mod acceptance;
pub mod array_command;
pub mod float16;
mod id;
pub mod node_status;
pub mod temperature;
pub mod thesis;
mod transfer;

pub use id::{MessageId, NodeId, Priority};
pub use transfer::{Payload, SingleFrame, TransferId, single_frame};

/// A payload that is not what its type says; the transfer is dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Malformed;
