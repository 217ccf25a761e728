//! A DroneCAN bus on a MAVLink ground station's screen.
//!
//! ```text
//! Bus (slcan, mcast, socketcan) ── frames ──> Bridge ── posts ──> Queue ── Writer ──> Channel (udp, tcp, serial)
//!                               <── frames ──        <── requests ── Parser ──────────
//! ```
//! [`core::Bridge`] decides; it neither opens nor waits. Its parts (parameters, commands, forward, presence, identity) work on a
//! [`state::State`] and do not know the core. [`bus`] and [`channel`] are what it is joined to, and never block.
//! [`run`] moves between them what there is. See docs/bridge.md.

#![forbid(unsafe_code)]

pub mod args;
mod calls;
mod channel;
mod commands;
pub mod core;
mod early;
mod forward;
mod ftp;
mod identity;
pub mod message;
mod names;
mod node;
pub mod number;
mod parameters;
pub mod post;
mod presence;
mod pty;
pub mod queue;
pub mod run;
mod screen;
pub mod state;
pub mod task;
pub mod tunnel;

use can_link as bus;
