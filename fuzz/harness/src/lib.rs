//! What is done with an input of the fuzzer, and what must then hold: a module for each target of `fuzz/`, with a function
//! `run`, which panics where it does not hold.
//!
//! It is a crate of its own so that the fuzzer and the tests do the same: `tests/corpus.rs` runs all inputs of `fuzz/corpus`.
//! What is to hold is written down here once more, from the specification and the documents of the node, and with the codec of
//! `dronecan-host`: nothing is compared with itself.

#![forbid(unsafe_code)]

pub mod bridge;
pub mod eeprom;
pub mod host;
pub mod node;
mod orders;
pub mod rig;
pub mod sim;
pub mod steps;
