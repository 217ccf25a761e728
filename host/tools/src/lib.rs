//! What the programs `node-update` and `node-check` do, without I/O. So it also runs in a web page.

#![forbid(unsafe_code)]

pub mod check;
pub mod update;
