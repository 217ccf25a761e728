//! Driver of the MCP2515.

#![no_std]
#![forbid(unsafe_code)]
#![deny(missing_docs)]

#[cfg(test)]
extern crate std;

mod bit_timing;
mod counters;
mod driver;
mod frame;
mod registers;
mod rx_order;
mod tx_order;

pub use bit_timing::BitTiming;
pub use counters::{Counter, Counters, WORDS};
pub use driver::{Acceptance, ErrorFlags, Event, Mcp2515, Notice, Pattern, RETRY_MS, SUPERVISION_MS, State};
pub use frame::Frame;
