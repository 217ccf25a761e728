//! Checks a real board with the node of this project, without I/O: frames, serial bytes, answers and
//! the time in; frames, questions and the rows of a report out. So it also runs in a web page.
//!
//! [`session`] is the state machine, [`checks`] has what is checked, [`desk`] what the checks share,
//! and [`report`] the result. The program `node-check` adds the adapter, the serial port, the
//! terminal and the files.

#![forbid(unsafe_code)]

#[cfg(not(target_family = "wasm"))]
pub mod args;
pub mod checks;
pub mod desk;
pub mod measure;
pub mod report;
pub mod session;
