//! What joins the simulated bench to the programs of this host: adapters, ports, networks, logs, debuggers.
//!
//! A [`Link`] is served between two short slices of simulated time. It never blocks: a client that hangs, floods or dies is
//! the link's affair, and the simulation goes on.

pub mod gdb;
pub mod log;
pub mod mcast;
pub mod pty;
pub mod script;
pub mod serial;
pub mod slcan;
pub mod vcd;

use crate::bench::Bench;
use crate::can::Record;
use anyhow::Result;
use clap::Args as ClapArgs;
use std::path::PathBuf;

/// Options for what is joined to the bench.
#[derive(Clone, Debug, Default, ClapArgs)]
#[command(next_help_heading = "Joining other programs")]
pub struct Args {
    /// Offer an SLCAN adapter on a pseudo-terminal, linked at PATH (repeatable: one client each, all on the one bus)
    #[arg(long, value_name = "PATH")]
    pub slcan: Vec<PathBuf>,

    /// Offer the Arduino's USB serial port on a pseudo-terminal, linked at PATH; opening it resets the board
    #[arg(long, value_name = "PATH")]
    pub serial: Option<PathBuf>,

    /// Start with a flash that is empty but for this bootloader, an Intel HEX file; upload through --serial
    #[arg(long, value_name = "HEX", requires = "serial")]
    pub bootloader: Option<PathBuf>,

    /// Join the UDP multicast bus N of pydronecan, libcanard and ArduPilot SITL, on loopback
    #[arg(long, value_name = "N")]
    pub mcast: Option<u8>,

    /// Address of the network interface for --mcast, if it is to leave this machine
    #[arg(long, value_name = "ADDRESS", requires = "mcast")]
    pub mcast_interface: Option<std::net::Ipv4Addr>,

    /// Log the bus: candump text, or pcap if FILE ends in .pcap
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,

    /// Record CAN, SPI, INT, UART and servo as one-bit wires for sigrok and GTKWave
    #[arg(long, value_name = "FILE")]
    pub vcd: Option<PathBuf>,

    /// Wait for avr-gdb on this TCP port of loopback
    #[arg(long, value_name = "PORT")]
    pub gdb: Option<u16>,

    /// Play frames and bench events from FILE: candump lines, and lines such as "(2.5) temperature 60"
    #[arg(long, value_name = "FILE")]
    pub script: Option<PathBuf>,

    /// Put this many further boards with the same firmware on the bus
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub nodes: usize,

    /// Keep the node's EEPROM in FILE from run to run
    #[arg(long, value_name = "FILE")]
    pub eeprom: Option<PathBuf>,
}

/// Something outside of the simulation.
pub trait Link {
    /// Passes on what came from outside and what goes there. Called between slices of at most a millisecond of simulated time.
    ///
    /// # Errors
    /// Only what makes going on pointless, such as a full disk; what a client does wrong is no error.
    fn serve(&mut self, bench: &mut Bench) -> Result<()>;

    /// A frame or an error frame that has passed on the bus; `from` is the name of its sender, if there is one.
    fn record(&mut self, _record: &Record, _from: Option<&str>) -> Result<()> {
        Ok(())
    }

    /// A line that says what it is and how it does, for people.
    fn status(&self) -> String;

    /// Whether a client on the wall clock may be attached, so that the simulation must keep real time.
    fn needs_real_time(&self) -> bool {
        false
    }
}
