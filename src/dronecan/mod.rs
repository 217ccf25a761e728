//! The DroneCAN (UAVCAN v0) wire format: identifiers, data types, received transfers, their CRC, and float16.
//!
//! Source: DroneCAN specification, chapters 3 and 4, and the DSDL files named in each module. What the node sends is made in
//! [`node::outgoing`](crate::node::outgoing).

pub mod acceptance;
pub mod crc;
#[cfg(feature = "draft")]
pub mod draft;
pub mod float16;
mod id;
pub mod kind;
pub mod receive;
pub mod wire;

pub use id::NodeId;
