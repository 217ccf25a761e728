//! Links join the simulated bench to programs and files of this computer: adapters, ports,
//! networks, logs, debuggers.
//!
//! The scene serves each [`Link`] between two short slices of simulated time. A link never blocks.
//! It must cope with a client that hangs, ends, or sends too much, so that the simulation goes on.

pub mod eeprom;
pub mod gdb;
pub mod log;
pub mod mcast;
pub mod pty;
#[cfg(test)]
pub(crate) mod scratch;
pub mod script;
pub mod serial;
pub mod slcan;
pub mod vcd;

use crate::usage::within;
use anyhow::Result;
use bench::Bench;
use bench::Cycles;
use bench::can::Record;
use bench::wiring::Pin;
use clap::Args as ClapArgs;
use std::path::{Path, PathBuf};

/// Options for the links of the bench.
#[derive(Clone, Debug, Default, ClapArgs)]
#[command(next_help_heading = "Joining other programs")]
#[group(id = "links")]
pub struct Args {
    /// Offer an SLCAN adapter on a pseudo-terminal, linked at PATH
    ///
    /// Repeatable: one client for each, all on the same bus.
    #[arg(long, value_name = "PATH")]
    pub slcan: Vec<PathBuf>,

    /// Offer the Arduino's USB serial port on a pseudo-terminal, linked at PATH; opening it resets
    /// the board
    #[arg(long, value_name = "PATH")]
    pub serial: Option<PathBuf>,

    /// Let the board understand any baud rate of --serial, as if it matched
    #[arg(long, requires = "serial")]
    pub serial_any_baud: bool,

    /// Load this bootloader, an Intel HEX file, beside the program, and start it [default HEX: the
    /// one that "make boot" has built for the board]
    #[arg(long, value_name = "HEX", num_args = 0..=1)]
    pub bootloader: Option<Option<PathBuf>>,

    /// Leave the flash empty but for the bootloader, for an upload or an update
    #[arg(long, requires = "bootloader")]
    pub no_program: bool,

    /// Join the UDP multicast bus N, 0 to 255, of pydronecan, libcanard and ArduPilot SITL, on
    /// loopback
    #[arg(long, value_name = "N", value_parser = within(0..=u8::MAX), allow_hyphen_values = true)]
    pub mcast: Option<u8>,

    /// Address of the network interface for --mcast, to reach other computers [default: loopback]
    #[arg(long, value_name = "ADDRESS", requires = "mcast")]
    pub mcast_interface: Option<std::net::Ipv4Addr>,

    /// Log the bus: candump text; pcap if FILE ends in .pcap; one line for each transfer, decoded,
    /// if it ends in .txt
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,

    /// Record CAN, SPI, INT, UART, outputs and the pins of --watch for sigrok and GTKWave
    ///
    /// Each is a signal of one bit. The file grows by 1 MB for each simulated second of this node,
    /// by up to 50 MB on a full bus, and by up to 200 MB with a program that does nothing but poll
    /// over the SPI. A save file for GTKWave, FILE with the ending .gtkw, is written beside it.
    #[arg(long, value_name = "FILE")]
    pub vcd: Option<PathBuf>,

    /// The signals of --vcd, with commas: CAN, CS, SCK, MOSI, MISO, INT, TXD, RXD, SERVO, OUT2 to
    /// OUT8 [default: all]
    #[arg(
        long,
        value_name = "NAMES",
        requires = "vcd",
        value_delimiter = ',',
        value_parser = vcd::signal
    )]
    pub vcd_signals: Vec<vcd::Wire>,

    /// Wait for avr-gdb on this TCP port of loopback, 1 to 65535; the board is halted at its reset
    /// until avr-gdb has come
    #[arg(
        long,
        value_name = "PORT",
        value_parser = within(1..=u16::MAX),
        allow_hyphen_values = true,
    )]
    pub gdb: Option<u16>,

    /// Play frames and bench events from FILE: candump lines, and lines such as "(2.5) temperature
    /// 60"
    ///
    /// Other events are "pwr-voltage 1260", "pwr-current 330", "button press", "button release",
    /// "fault cable", "set D7 low", "rpm 6000", "i2c 0x48:0=1" and "serial TEXT".
    #[arg(long, value_name = "FILE")]
    pub script: Option<PathBuf>,

    /// Put this many further boards, 0 to 126, with the same firmware on the bus. Those of this
    /// project get other node IDs, unless --eeprom has them
    #[arg(
        long,
        value_name = "N",
        default_value_t = 0,
        value_parser = within(0..=FURTHER_BOARDS_MAX),
        allow_hyphen_values = true,
    )]
    pub nodes: usize,

    /// Keep the node's EEPROM in FILE from run to run; further boards use FILE.1, FILE.2 and so on
    #[arg(long, value_name = "FILE")]
    pub eeprom: Option<PathBuf>,
}

/// Node IDs are 1 to 127, and the node has one of them.
const FURTHER_BOARDS_MAX: usize = 126;

impl Args {
    /// Opens all links of the options except for the script. `boards` are the numbers of all
    /// boards, the node under test first. `boot_section` is the first byte of its bootloader. --vcd
    /// also records the pins `watched` of the node.
    ///
    /// # Errors
    /// If a link cannot be opened, for example because its path or port is in use; the message says
    /// what to do. The links that were open are closed again.
    pub fn open(
        &self,
        bench: &mut Bench,
        boards: &[usize],
        boot_section: Option<usize>,
        watched: &[Pin],
    ) -> Result<Vec<Box<dyn Link>>> {
        let node = boards[0];
        let mut links: Vec<Box<dyn Link>> = Vec::new();
        if let Some(path) = &self.eeprom {
            for (number, board) in boards.iter().enumerate() {
                links.push(Box::new(eeprom::EepromFile::open(
                    &numbered(path, number),
                    bench,
                    *board,
                )?));
            }
        }
        for path in &self.slcan {
            links.push(Box::new(slcan::open(path, bench)?));
        }
        if let Some(path) = &self.serial {
            let port = serial::SerialPort::open(path, node, boot_section, self.serial_any_baud)?;
            links.push(Box::new(port));
        }
        if let Some(bus) = self.mcast {
            links.push(Box::new(mcast::Mcast::open(bus, self.mcast_interface, bench)?));
        }
        if let Some(port) = self.gdb {
            links.push(Box::new(gdb::Gdb::open(port, bench, node)?));
        }
        // Files come last, so that an error above leaves no empty file.
        if let Some(path) = &self.log {
            links.push(Box::new(log::Log::create(path, bench.bus().bit_rate())?));
        }
        if let Some(path) = &self.vcd {
            links.push(Box::new(vcd::Vcd::create(path, &self.vcd_signals, watched, bench, node)?));
        }
        Ok(links)
    }
}

/// `FILE` for number 0, else `FILE.number`.
fn numbered(path: &Path, number: usize) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    if number > 0 {
        name.push(format!(".{number}"));
    }
    name.into()
}

/// A connection between the bench and a program or file outside of the simulation.
pub trait Link {
    /// Transfers data in both directions. Called between slices of at most a millisecond of
    /// simulated time.
    ///
    /// # Errors
    /// If the run cannot go on, for example because the disk is full. An error of a client is not
    /// such an error.
    fn serve(&mut self, bench: &mut Bench) -> Result<()>;

    /// Takes a frame or an error frame of the bus; `from` is the name of its sender, if known.
    ///
    /// # Errors
    /// If the run cannot go on.
    fn record(&mut self, _record: &Record, _from: Option<&str>) -> Result<()> {
        Ok(())
    }

    /// Takes bytes that a board has sent on its serial port, each with the time of the end of its
    /// stop bit, at `rate` bits per second.
    fn serial_output(&mut self, _board: usize, _bytes: &[(Cycles, u8)], _rate: u64) {}

    /// Ends the run: writes what the link has to keep.
    ///
    /// # Errors
    /// If the link cannot write its file.
    fn finish(&mut self, _bench: &mut Bench) -> Result<()> {
        Ok(())
    }

    /// A line for the user: what the link is, and its state.
    fn status(&self) -> String;

    /// Removes and returns a hint for the user: the probable cause of an error that the link has
    /// seen since the last call.
    fn take_hint(&mut self) -> Option<String> {
        None
    }

    /// True if a client that uses the wall clock can be attached, so that the simulation must keep
    /// real time.
    fn needs_real_time(&self) -> bool {
        false
    }

    /// True while a board gives a client that uses the wall clock a limited time to answer. Then
    /// simulated time passes more slowly, so that a busy computer is no slow client.
    fn gives_time(&self) -> bool {
        false
    }
}
