//! Host-side codec for DroneCAN v0: what the bench sends as an autopilot and shows as bus traffic.
//!
//! It is written from the DroneCAN specification (chapters 3 to 5) and the public DSDL, and shares nothing with the
//! firmware, so that neither can hide a mistake of the other. Layers, lowest first: [`crc`], [`id`] (the 29-bit
//! identifier), [`transfer`] (tail byte, splitting, assembly), [`types`] (names and signatures), and the payloads that the
//! node has to do with: [`message`], [`broadcast`] and, for services, [`management`].
//!
//! Limits: extended data frames only, as the dialect has no others; types beyond [`Message`] are named, not decoded.

pub mod broadcast;
pub mod crc;
pub mod id;
pub mod management;
pub mod message;
pub mod transfer;
pub mod types;

#[cfg(test)]
mod tests;

pub use broadcast::{Allocation, CanStats, KeyValue, LightCommand};
pub use id::{CanId, NodeId};
pub use management::{NodeInfo, Opcode, ParameterRequest, ParameterResponse, RESTART_MAGIC, TransportStats, Value};
pub use message::{ActuatorCommand, ActuatorStatus, CommandUnit, Health, Message, Mode, NodeStatus, Temperature};
pub use transfer::{Assembler, Outcome, Transfer, TransferId, split};
pub use types::{DataType, Kind};
