//! Sends a firmware to nodes over the DroneCAN bus: `make update`.
//!
//! The program reads the file, opens the bus, finds the nodes, and updates them. What to send and
//! when is the library's; [`client::Client`] sends and receives for it.

#![forbid(unsafe_code)]

mod client;
mod find;
mod progress;
mod update;

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, Error};
use clap::Parser as _;
use dronecan_host::text::visible;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use client::Client;
use node_tools::update::args::Args;
use node_tools::update::file::FirmwareFile;

/// Why the program ends before all nodes are updated.
enum Failure {
    Other(Error),
    /// The command line or the file is wrong.
    Usage(Error),
    Bus(Error),
    /// These nodes were not updated or not found.
    Nodes(Error),
    Interrupted,
}

fn main() -> ExitCode {
    let (code, error) = match run(&Args::parse()) {
        Ok(()) => return ExitCode::SUCCESS,
        Err(Failure::Other(error)) => (1, error),
        Err(Failure::Usage(error)) => (2, error),
        Err(Failure::Bus(error)) => (3, error),
        Err(Failure::Nodes(error)) => (4, error),
        Err(Failure::Interrupted) => (5, Error::msg("ended by a signal")),
    };
    eprintln!("node-update: {}", visible(&format!("{error:#}")));
    ExitCode::from(code)
}

fn run(args: &Args) -> Result<(), Failure> {
    let interrupted = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, interrupted.clone())
            .context("cannot handle signals")
            .map_err(Failure::Other)?;
    }
    let file = FirmwareFile::read(&args.file).map_err(Failure::Usage)?;
    println!("{}", visible(&format!("{}: {file}", args.file.display())));
    if !args.last && !file.takes_updates() {
        return Err(Failure::Usage(Error::msg(
            "this program has no feature \"update\": the node would take no further update over \
             the bus. Build FEATURES=remote for an ATmega168, or add --last",
        )));
    }
    let mut client = Client::open(args, interrupted).map_err(Failure::Bus)?;
    let result = find::find(&mut client, args, &file)
        .and_then(|(own_id, nodes)| update::update(&mut client, args, file, own_id, nodes));
    client.close();
    result
}
