//! Sends a firmware to nodes over the DroneCAN bus: `make update`.
//!
//! The program reads the file, opens the bus, finds the nodes, and updates one after the other.
//! [`session::Session`] decides what an update does next, and neither waits nor sends;
//! [`client::Client`] sends and receives for it. docs/update.md describes the files and the
//! bootloader.

#![forbid(unsafe_code)]

mod args;
mod client;
mod file;
mod progress;
mod search;
mod session;

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, Error};
use clap::Parser as _;
use dronecan_host::text::visible;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use args::Args;
use client::Client;
use file::FirmwareFile;
use progress::Progress;
use search::Candidate;
use session::{Outcome, Session};

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
    let mut client = Client::open(args, interrupted).map_err(Failure::Bus)?;
    let result = update_all(&mut client, args, &file);
    client.close();
    result
}

/// Finds the nodes and updates them, one after the other.
fn update_all(client: &mut Client, args: &Args, file: &FirmwareFile) -> Result<(), Failure> {
    let nodes = search::search(client, args, file)?;
    let count = nodes.len();
    let mut failed = Vec::new();
    for Candidate { id, info } in nodes {
        let mut session = Session::new(id, info.software, file, client.id, client.now());
        let mut progress = Progress::new(id, file.bytes.len(), args.plain);
        let outcome =
            client.run(&mut session, |session| progress.show(session)).map_err(Failure::Bus)?;
        progress.end();
        match outcome {
            Some(Outcome::Updated(text)) => println!("node {id}: {}", visible(&text)),
            Some(Outcome::Failed(text)) => {
                println!("node {id}: FAILED: {}", visible(&text));
                failed.push(id.to_string());
            }
            None => {
                println!("node {id}: {}", session.state_if_ended_now());
                return Err(Failure::Interrupted);
            }
        }
    }
    if failed.is_empty() {
        return Ok(());
    }
    let error = format!("{} of {count} nodes not updated: {}", failed.len(), failed.join(", "));
    Err(Failure::Nodes(Error::msg(error)))
}
