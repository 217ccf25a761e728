//! DroneCAN v0 for programs on a host: the wire format, and the formats in which frames reach other
//! programs. Also the draft of 2014, which came before it.
//!
//! The simulator, its tests and the MAVLink bridge use it. It was written from the DroneCAN
//! specification (chapters 3 to 5) and the public DSDL and shares no code with the firmware, so
//! that neither can hide a mistake of the other. Layers, lowest first: [`Frame`], [`crc`], [`id`]
//! (the 29-bit identifier), [`transfer`] (tail byte, splitting, assembly), `table` (a row for each
//! data type and message), [`types`] (names, signatures and lengths, from the table), the payloads
//! that are decoded completely ([`status`], [`actuator`], [`broadcast`], [`battery`], [`esc`], and
//! for services [`management`]), and [`message`] with all of them, from the table, too. [`text`]
//! formats them. [`draft`] has the same layers for the draft, and [`dialect`] finds the dialect of
//! a frame. Besides there are [`slcan`], the text protocol of serial adapters, [`mcast`], the UDP
//! multicast bus, [`link`], the bus of a program, and [`help`], the `--help` of one.
//!
//! Limits: extended data frames only, because the dialect has no others. Types beyond [`Message`]
//! have a name and are not decoded.

#![forbid(unsafe_code)]

pub mod actuator;
pub mod battery;
mod bits;
pub mod broadcast;
pub mod crc;
pub mod dialect;
mod dispatch;
pub mod draft;
pub mod esc;
mod fields;
#[cfg(not(target_family = "wasm"))]
pub mod help;
pub mod id;
#[cfg(not(target_family = "wasm"))]
pub mod link;
pub mod management;
#[cfg(not(target_family = "wasm"))]
pub mod mcast;
pub mod message;
mod sessions;
pub mod slcan;
pub mod status;
mod table;
pub mod text;
pub mod transfer;
pub mod tunnel;
pub mod types;

#[cfg(test)]
mod tests;

pub use actuator::{ActuatorCommand, ActuatorStatus, CommandUnit};
pub use battery::BatteryInfo;
pub use broadcast::*;
pub use can_frame::{Frame, Id, ParseFrameError};
pub use dialect::{Decoded, Dialect, Observation, Observer};
pub use id::{CanId, NodeId};
pub use management::{
    NodeInfo, NumberAndText, Opcode, ParameterRequest, ParameterResponse, RESTART_MAGIC,
    TransportStats, Value,
};
pub use message::Message;
pub use status::{Health, Mode, NodeStatus};
pub use transfer::{Assembler, Outcome, Transfer, TransferId, frames, split};
pub use tunnel::{TunnelBroadcast, TunnelTargetted};
pub use types::{DataType, Kind};
