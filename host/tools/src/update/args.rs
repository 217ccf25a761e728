//! The command line.

use std::net::Ipv4Addr;
use std::path::PathBuf;

use crate::update::search::{Nodes, node_id};
use clap::Parser;
use dronecan_host::NodeId;
use dronecan_host::link as bus;

const EXAMPLES: &str = "\
Buses (--bus):
  slcan:/dev/ttyACM0        SLCAN adapter; slcan:PATH:BAUD where the baud rate matters; \"sim \
                        --slcan PATH\" offers one
  mcast:0                   UDP multicast bus of pydronecan, libcanard, ArduPilot SITL and \"sim \
                        --mcast 0\", on loopback
  socketcan:can0            a CAN interface of the Linux kernel

Examples:
  node-update uno-seeed.bin --bus slcan:/dev/ttyACM0 --node 120
  node-update uno-seeed.bin --bus socketcan:can0 --node all      each node whose hardware the file \
                        is for, four at a time

A node refuses while the vehicle is armed, or while its servo follows commands. An update takes 2 \
                        to 10 seconds. If it breaks off, the node
waits in its bootloader, and the same command continues it, at once or later. A loader that has \
                        lost its node ID waits as node 120.

Exit codes:
  0  all nodes were updated                     3  the bus cannot be opened, or was lost
  1  something else went wrong                  4  a node was not found, or not updated
  2  the command line or the file is wrong      5  ended by a signal";

/// Sends a firmware to DroneCAN nodes with the bootloader of this project, over the bus. "make
/// firmware" makes the file, which ends with ".bin".
#[derive(Clone, Debug, Parser)]
#[command(name = "node-update", version, after_help = EXAMPLES)]
pub struct Args {
    /// The firmware: a .bin of "make firmware"
    pub file: PathBuf,

    /// The DroneCAN bus: slcan:PATH, mcast:N or socketcan:NAME
    #[arg(long, value_name = "BUS")]
    pub bus: bus::Spec,

    /// The node to update: its node ID, or "all"
    #[arg(long, value_name = "ID", allow_hyphen_values = true)]
    pub node: Nodes,

    /// Bit rate of the bus, for slcan:
    #[arg(long, value_name = "BIT/S", default_value_t = 1_000_000)]
    pub bitrate: u32,

    /// Address of the network interface for mcast:, to reach other machines
    #[arg(long, value_name = "ADDRESS")]
    pub mcast_interface: Option<Ipv4Addr>,

    /// Node ID of this program on the bus, if no other node has it [default: one that is free]
    #[arg(long, value_name = "ID", value_parser = node_id, allow_hyphen_values = true)]
    pub own_id: Option<NodeId>,

    /// Send a program without the feature "update", after which the node takes no further update
    /// over the bus
    #[arg(long)]
    pub last: bool,

    /// Print lines even if the output is a terminal
    #[arg(long)]
    pub plain: bool,
}
