//! CAN: frames, bit timing, and the driver of the MCP2515.

pub mod bit_timing;
mod frame;
pub mod mcp2515;

pub use frame::Frame;
