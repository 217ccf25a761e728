//! Runs an input of the fuzzer and checks what must hold: a module for each target of `fuzz/`, with a function `run` that panics on a
//! failed check.
//!
//! It is a crate of its own so that the fuzzer and the tests do the same: `tests/corpus.rs` runs all inputs of `fuzz/corpus`.
//! The checks are written from the specification and the documents of the node, with the codec of `dronecan-host`, so that no code is
//! compared with itself.

#![forbid(unsafe_code)]

pub mod bridge;
pub mod eeprom;
pub mod host;
pub mod node;
mod orders;
pub mod rig;
pub mod sim;
pub mod steps;
