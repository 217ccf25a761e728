//! Runs inputs of the fuzzer. Each target of `fuzz/` has a module with a function `run`, which
//! panics if a check fails.
//!
//! This is a separate crate so that the fuzzer and the tests run the same code: `corpus.rs` runs
//! all inputs of `tests/fuzz/corpus`. The checks follow the specification and the node's
//! documents, and use the codec of `dronecan-host`, so that no code is compared with itself.

#![forbid(unsafe_code)]

pub mod bridge;
pub mod commanders;
#[cfg(test)]
mod corpus;
pub mod eeprom;
pub mod host;
pub mod node;
mod orders;
pub mod rig;
pub mod sim;
pub mod steps;
