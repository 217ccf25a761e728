#![doc = include_str!("../README.md")]
//! # How it works
//!
//! ```text
//! Bus ── drive()/sample() per bit ──> Station (SoftNode, Mcp2515, ..) ── owns ──> Engine
//!  ├─ Faults: what goes wrong on the wire                                          ├─ Parser
//!  └─ Recorder: a silent Engine that writes down what passed                       └─ Confinement
//! ```
//!
//! In each bit the bus asks every station for the level it drives, joins them (dominant wins), applies
//! the faults, and gives every station the level that resulted. Arbitration,
//! acknowledgement, error and overload frames are not calculated anywhere: they follow from the
//! engines' rules.
//!
//! ## What is simplified
//! * A bit has one level. Sample points, propagation delay, and resynchronisation inside a bit are
//!   not modelled: stations at (nearly) the bus's bit rate are in step with it. A station at another
//!   rate runs freely against the wire and is never synchronised, not even by a SOF.
//! * A station that may not drive (listen-only) waits after an error for eight recessive bits instead
//!   of playing its own error flag internally. See [`Engine`].
//! * No CAN FD: a recessive reserved bit is accepted as CAN 2.0 demands, not taken for an FD frame.
//! * Nobody asks for overload frames; they are sent only where the protocol forces one.
//!
//! Source: Bosch CAN Specification 2.0 part B (1991); ISO 11898-1:2003 clauses 10 to 13.

#![forbid(unsafe_code)]

mod bit_clock;
mod bus;
mod confinement;
mod engine;
mod event;
mod fault;
mod parser;
mod port;
mod recorder;
mod soft_node;
mod station;
mod wire;

#[cfg(test)]
mod tests;

pub use bus::Bus;
pub use can_frame::{Frame, Id, ParseFrameError};
pub use confinement::ErrorState;
pub use engine::{Engine, EngineMode};
pub use event::{ErrorKind, Event, Events};
pub use fault::Fault;
pub use port::PortId;
pub use recorder::{BusStats, PortStats, Record, RecordKind};
pub use soft_node::SoftNode;
pub use station::{Station, StationRef};
pub use wire::{Level, OnWire, max_bits, min_bits};
