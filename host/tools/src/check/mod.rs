//! Checks a real board with the node of this project, without I/O: frames, serial bytes, answers
//! and the time in; frames, questions and the rows of a report out. So it also runs in a web page.
//!
//! [`session`] is the state machine, [`checks`] has the checks in their order, [`desk`] what they
//! share, and [`report`] the result. The program `node-check` adds the adapter, the serial port,
//! the terminal and the files.

#[cfg(not(target_family = "wasm"))]
pub mod args;
mod board;
mod checks;
pub mod desk;
mod find;
mod hands;
mod measure;
pub mod report;
pub mod session;
mod store;
mod update;
mod vcd;
mod watch;
