#![doc = include_str!("../README.md")]
#![cfg_attr(not(any(test, feature = "golden")), no_std)]
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod bits;
pub mod crc;
pub mod esc;
pub mod fields;
pub mod float16;
#[cfg(any(test, feature = "golden"))]
pub mod golden;
mod length;
mod node_id;
pub mod receive;
pub mod send;
pub mod signature;
pub mod types;

pub use bits::{Id, Tail};
pub use length::Length;
pub use node_id::NodeId;
pub use receive::{
    CompleteFirst, LongReceiver, Policy, Received, Receiver, Rejection, Segment, Slot, Transfer,
    Verdict,
};
pub use send::{Buffer, Data, LongSender, Payload, Sender};
