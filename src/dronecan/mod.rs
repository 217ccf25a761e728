//! The DroneCAN (UAVCAN v0) wire format: identifiers, transfers, and one file for each message that the node uses.
//!
//! Source: DroneCAN specification, chapters 3 and 4, and the DSDL files named in each module. All messages here fit in one
//! frame: up to seven bytes of payload and a tail byte.

pub mod acceptance;
pub mod crc;
pub mod float16;
mod id;
pub mod kind;
pub mod receive;

pub use id::NodeId;
