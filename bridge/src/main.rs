//! A DroneCAN bus on a MAVLink ground station's screen.
//!
//! ```text
//! Bus (slcan, mcast, socketcan) ── frames ──> Bridge ── posts ──> Queue ── Writer ──> Channel (udp, tcp, serial)
//!                               <── frames ──        <── requests ── Parser ──────────
//! ```
//! [`core::Bridge`] decides; it neither opens nor waits. [`bus`] and [`channel`] are what it is joined to, and never block.
//! [`run`] moves between them what there is. See docs/bridge.md.

#![forbid(unsafe_code)]

mod args;
mod bus;
mod calls;
mod channel;
mod commands;
mod core;
mod forward;
mod message;
mod names;
mod node;
mod number;
mod parameters;
mod queue;
mod run;
mod screen;

use args::Args;
use clap::Parser as _;
use run::Failure;
use std::process::ExitCode;

fn main() -> ExitCode {
    match run::run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err((failure, error)) => {
            eprintln!("bridge: {error:#}");
            ExitCode::from(match failure {
                Failure::Other => 1,
                Failure::Usage => 2,
                Failure::Bus => 3,
                Failure::Channel => 4,
                Failure::Names => 5,
            })
        }
    }
}
