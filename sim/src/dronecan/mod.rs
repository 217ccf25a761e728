//! Host-side codec for DroneCAN v0: what the bench sends as an autopilot and shows as bus traffic.
//!
//! It is written from the DroneCAN specification (chapters 3 to 5) and the public DSDL, and shares nothing with the
//! firmware, so that neither can hide a mistake of the other. Layers, lowest first: [`crc`], [`id`] (the 29-bit
//! identifier), [`transfer`] (tail byte, splitting, assembly), [`types`] (names and signatures) and [`message`]
//! (the few payloads that the bench needs in full).
//!
//! Limits: extended data frames only, as the dialect has no others; types beyond [`Message`] are named, not decoded.

pub mod crc;
pub mod id;
pub mod message;
pub mod transfer;
pub mod types;

#[cfg(test)]
mod tests;

pub use id::{CanId, NodeId};
pub use message::{ActuatorCommand, ActuatorStatus, CommandUnit, Health, Message, Mode, NodeStatus, Temperature};
pub use transfer::{Assembler, Outcome, Transfer, TransferId, split};
pub use types::{DataType, Kind};
