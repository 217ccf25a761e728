//! The draft of 2014: what UAVCAN was until April 2015, and what the ArduPilot of the thesis spoke.
//!
//! It shares the CRC, float16 and node IDs with v0, and most payloads in spirit; the identifier is another one, frames have no
//! tail byte, and the frames of a transfer are numbered in the identifier. Layers as for v0: [`CanId`], [`transfer`],
//! [`types`], [`message`].
//!
//! Sources: libuavcan at 7d23c7be (2014-12-27) and 3b3c0d3b (2015-03-19), uc_frame.cpp, transfer.hpp and dsdl/uavcan. The
//! signatures are computed with pydronecan, from the field lists in tests/clients/draft.py.
//!
//! Limits: an ArrayCommand is that of a node of the thesis's time, three bytes for a command; at the later commit four bits in
//! between say its unit. ExecuteOpcode 598 is only named, for its definition at that date is not to be had.

mod bits;
pub mod id;
pub mod message;
mod parameters;
pub mod transfer;
pub mod types;

#[cfg(test)]
mod tests;

pub use id::{CanId, TransferId, TransferType};
pub use message::{ActuatorCommand, Message, NodeInfo, NodeStatus, StatusCode, VendorCode};
pub use transfer::{Assembler, Outcome, Route, Transfer};
pub use types::DataType;
