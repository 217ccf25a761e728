//! The draft of 2014: UAVCAN until April 2015, which the ArduPilot of the thesis used.
//!
//! It has the CRC, float16 and node IDs of v0, and similar payloads. Its identifier differs, frames have no tail byte, and the
//! identifier has the number of the frame in its transfer. Layers as for v0: [`CanId`], [`transfer`],
//! [`types`], [`message`].
//!
//! Sources: libuavcan at 7d23c7be (2014-12-27) and 3b3c0d3b (2015-03-19), uc_frame.cpp, transfer.hpp and dsdl/uavcan. The
//! signatures are computed with pydronecan, from the field lists in tests/clients/draft.py.
//!
//! Limits: ArrayCommand has three bytes for a command, as at the time of the thesis; at the later commit four bits in between are
//! its unit. ExecuteOpcode 598 has a name only, because its definition of that date is not available.

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
