#![doc = include_str!("../README.md")]
//! # How it works
//!
//! ```text
//! Bus ── drive()/sample() per bit ──> Station (SoftNode, Mcp2515, ..) ── owns ──> Engine
//!  ├─ Faults: faults on the wire                                                    ├─ Parser
//!  └─ Recorder: a silent Engine that records the frames                            └─ Confinement
//! ```
//!
//! In each bit the bus calls every station for the level that it drives, combines the levels
//! (dominant wins), applies the faults, and passes the result to every station. Arbitration,
//! acknowledgement, error and overload frames are not calculated: they follow from the
//! engines' rules. Idle bits and the bits of a frame that nothing can disturb are stepped at once,
//! with the same result.
//!
//! ## What is simplified
//! * A bit has one level. Sample points, propagation delay, and resynchronisation inside a bit are
//!   not modelled: stations at (nearly) the bus's bit rate are in step with it. A station at
//!   another rate runs freely and is never synchronised, not even by a SOF.
//! * A station that may not drive (listen-only) waits for eight recessive bits after an error
//!   instead of sending its own error flag internally. See [`Engine`].
//! * No CAN FD: a recessive reserved bit is accepted, as CAN 2.0 requires, and does not mean an FD
//!   frame.
//! * No station requests overload frames; they occur only where the protocol requires one.
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
