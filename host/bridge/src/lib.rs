//! Shows a DroneCAN bus to MAVLink ground stations.
//!
//! ```text
//! Bus ── frames ──> Bridge ── posts ──> Queue ── Writer ──> Channel
//!     <── frames ──        <── requests ── Parser ──────────
//! ```
//! A bus is slcan, mcast or socketcan, a channel udp, tcp or serial.
//! [`core::Bridge`] makes all decisions; it opens nothing and never waits. Its parts (parameters,
//! commands, forward, presence, identity) use a [`state::State`] and do not know the core. [`bus`]
//! and [`channel`] are its connections, and never block. [`run`] moves frames and messages between
//! them. See docs/bridge.md.

#![forbid(unsafe_code)]

pub mod args;
mod calls;
mod channel;
mod commands;
pub mod core;
mod early;
mod forward;
mod ftp;
pub mod help;
mod identity;
mod joined;
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
pub mod signing;
pub mod state;
pub mod task;
pub mod tunnel;

use dronecan_host::link as bus;
