//! The command line.

use std::path::PathBuf;

use crate::update::search::node_id;
use clap::Parser;
use dronecan_host::NodeId;
use dronecan_host::link as bus;

const EXAMPLES: &str = "\
Examples:
  node-check --bus slcan:/dev/ttyACM0 --node 120 --port /dev/ttyUSB0
  node-check --bus socketcan:can0 --node 120 < /dev/null      without a question

The program restarts the node, changes parameters, and puts them back, also at Ctrl-C and when the \
                        adapter was
pulled and is back. It ends while the vehicle is armed. It asks before it moves an output and \
                        before an update.
DIRECTORY gets report.md, for the form of an issue; report.json; and bus.log, which canplayer and \
                        \"sim --script\" play.

Exit codes:
  0  all passed                 2  the command line is wrong
  1  something failed           3  the adapter or the serial port cannot be opened, or was lost
                             5  ended by a signal";

/// Checks a real board with the node of this project, in ten minutes, and writes a report.
#[derive(Clone, Debug, Parser)]
#[command(name = "node-check", version, after_help = EXAMPLES)]
pub struct Args {
    /// The DroneCAN bus: slcan:PATH, mcast:N or socketcan:NAME
    #[arg(long, value_name = "BUS")]
    pub bus: bus::Spec,

    /// Node ID of the board. The program sends requests to no other node
    #[arg(long, value_name = "ID", value_parser = node_id, allow_hyphen_values = true)]
    pub node: NodeId,

    /// Serial port of the Arduino. Opening it resets the board
    #[arg(long, value_name = "PATH")]
    pub port: Option<PathBuf>,

    /// Bit rate of the bus
    #[arg(long, value_name = "BIT/S", default_value_t = 1_000_000)]
    pub bitrate: u32,

    /// Files for an update: .bin of "make firmware". Only the program that the node has is sent
    #[arg(long, value_name = "FILE")]
    pub firmware: Vec<PathBuf>,

    /// How long error counters are observed
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 60,
        value_parser = clap::value_parser!(u64).range(20..=86_400),
    )]
    pub watch: u64,

    /// Where the report goes
    #[arg(long, value_name = "DIRECTORY", default_value = "node-check")]
    pub report: PathBuf,
}
