//! The draft of 2014: UAVCAN until April 2015, which the ArduPilot of the thesis used.
//!
//! It has v0's CRC, float16 and node IDs, and similar payloads. Its identifier differs and counts
//! the frames of a transfer, and frames have no tail byte. Layers as for v0: [`CanId`],
//! [`transfer`], [`types`], [`message`].
//!
//! Sources: libuavcan at 7d23c7be (2014-12-27) and 3b3c0d3b (2015-03-19), uc_frame.cpp,
//! transfer.hpp and dsdl/uavcan. The signatures are computed with pydronecan, from the field lists
//! in tests/clients/draft.py.
//!
//! Limits: a command in an ArrayCommand has three bytes, as at the time of the thesis; in the later
//! commit it also has a unit of four bits. ExecuteOpcode 598 has only a name, because its
//! definition of that date is not available.

pub mod id;
pub mod message;
mod parameters;
mod table;
pub mod transfer;
pub mod types;

#[cfg(test)]
mod tests;

pub use id::{CanId, TransferId, TransferType};
pub use message::{ActuatorCommand, Message, NodeInfo, NodeStatus, StatusCode, VendorCode};
pub use transfer::{Assembler, Outcome, Route, Transfer};
pub use types::DataType;
