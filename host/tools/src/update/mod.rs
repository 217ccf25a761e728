//! Updates the firmware of DroneCAN nodes over the bus, without I/O: frames and the time in, frames
//! out. It needs no threads, sockets, files or clock, so it also runs in a web page.
//!
//! [`tool`] is the program as a node on the bus. [`search`] finds the nodes to update, [`fleet`]
//! updates some at the same time, and [`session`] decides what the update of one does next. The
//! program `node-update` adds the bus, the command line and the display. docs/update.md describes
//! the files and the bootloader.

#[cfg(not(target_family = "wasm"))]
pub mod args;
pub mod file;
pub mod fleet;
pub mod heard;
pub mod search;
pub mod session;
pub mod tool;
