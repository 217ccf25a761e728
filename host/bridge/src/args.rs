//! The command line.

use crate::bus;
use crate::channel::{self, Integers};
use crate::message::Versions;
use crate::tunnel;
use clap::Parser;
use sim_base::parse_number;
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;
use std::time::Duration;

/// Smallest interval; shorter ones would only fill the channel.
const INFO_INTERVAL_MIN: Duration = Duration::from_secs(1);

/// Shows the nodes of a DroneCAN bus to MAVLink ground stations: their names and status. Ground
/// stations can read, set and save parameters and restart nodes; the DroneCAN GUI Tool can use the
/// bus itself. A node's MAVLink component ID is its node ID.
#[derive(Clone, Debug, Parser)]
#[command(name = "bridge", version)]
pub struct Args {
    /// The DroneCAN bus: slcan:PATH, mcast:N or socketcan:NAME
    #[arg(long, value_name = "BUS")]
    pub bus: bus::Spec,

    /// A MAVLink channel: udpout:HOST:PORT, udpin:PORT, tcp:HOST:PORT, tcpin:PORT or
    /// serial:PATH:BAUD (repeatable)
    #[arg(long, value_name = "CHANNEL", required_unless_present_any = ["names", "tunnel"])]
    pub mavlink: Vec<channel::Spec>,

    /// Node that is a MAVLink component by itself, as an autopilot is: the bridge sends no
    /// heartbeat for it, and answers no message to it. Not needed if the bridge receives the
    /// heartbeats of that component (repeatable)
    #[arg(long, value_name = "NODE", value_parser = node_id, allow_hyphen_values = true)]
    pub hide: Vec<u8>,

    /// A serial port of a node over the bus: NODE:PTY creates the pseudo-terminal PTY and connects
    /// it with that node (tunnel.Targetted). ",port=N" chooses another port than the default
    /// one, ",lock" keeps the node from using it; ",broadcast=PROTOCOL" uses tunnel.Broadcast
    /// (repeatable)
    #[arg(long, value_name = "NODE:PTY")]
    pub tunnel: Vec<tunnel::Spec>,

    /// Bit rate of the bus, for slcan:
    #[arg(long, value_name = "BIT/S", default_value_t = 1_000_000)]
    pub bitrate: u32,

    /// Address of the network interface for mcast:, to reach other machines
    #[arg(long, value_name = "ADDRESS")]
    pub mcast_interface: Option<Ipv4Addr>,

    /// MAVLink system ID of the bridge and all nodes: that of the vehicle
    #[arg(
        long,
        value_name = "ID",
        default_value_t = 1,
        value_parser = from_one,
        allow_hyphen_values = true,
    )]
    pub system: u8,

    /// MAVLink component ID of the bridge, and its node ID on the bus
    #[arg(
        long,
        value_name = "ID",
        default_value_t = 126,
        value_parser = from_one,
        allow_hyphen_values = true,
    )]
    pub component: u8,

    /// The bridge's node ID on the bus, if it differs from its component ID
    #[arg(long, value_name = "ID", value_parser = node_id, allow_hyphen_values = true)]
    pub node_id: Option<u8>,

    /// Highest rate of the statuses of each node, at least 1. Without it all statuses, unless the
    /// channel is full
    #[arg(long, value_name = "HZ", value_parser = status_rate, allow_hyphen_values = true)]
    pub status_rate: Option<f64>,

    /// Time between two UAVCAN_NODE_INFO of each node. They are also sent when a node appears or
    /// restarts, and on request
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = info_interval)]
    pub info_interval: Duration,

    /// Send no more than a serial line of this baud rate carries, on channels that lead to a radio
    #[arg(long, value_name = "BAUD", value_parser = bandwidth, allow_hyphen_values = true)]
    pub bandwidth: Option<u32>,

    /// Version of MAVLink to send
    #[arg(long, value_name = "VERSION", value_enum, default_value_t = Versions::Auto)]
    pub mavlink_version: Versions,

    /// How integers are written in PARAM_VALUE and read in PARAM_SET
    #[arg(long, value_name = "HOW", value_enum, default_value_t = Integers::Auto)]
    pub integers: Integers,

    /// Sign all messages, and accept signed messages only. FILE has the passphrase of the ground
    /// station, or 64 hexadecimal digits
    #[arg(long, value_name = "FILE")]
    pub signing_key: Option<PathBuf>,

    /// File with the times of the signatures that were accepted, so that none is accepted again
    /// after a restart [default: the key's FILE with ".times" behind its name]
    #[arg(long, value_name = "FILE", requires = "signing_key")]
    pub signing_state: Option<PathBuf>,

    /// Accept only stations at this address on udpin: and tcpin: (repeatable)
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    pub peer: Vec<IpAddr>,

    /// Reject all changes by ground stations: they cannot set, save, erase or restart, and cannot
    /// send frames on the bus
    #[arg(long, conflicts_with = "autosave")]
    pub read_only: bool,

    /// Let ground stations see the frames of the bus (CAN_FORWARD) and send frames (CAN_FRAME), as
    /// the DroneCAN GUI Tool does. Every station that reaches the bridge can then move a servo
    #[arg(long)]
    pub allow_can: bool,

    /// Save a node's parameters two seconds after the last PARAM_SET
    #[arg(long)]
    pub autosave: bool,

    /// Wait for the bus and the channels if they cannot be opened at the start
    #[arg(long)]
    pub wait: bool,

    /// Print all parameters of all nodes with their MAVLink names, and exit
    #[arg(long)]
    pub names: bool,

    /// Print lines even if the output is a terminal
    #[arg(long)]
    pub plain: bool,

    /// Exit after this time: 500ms, 10s, 5m, 1h
    #[arg(long = "for", value_name = "TIME", value_parser = duration, allow_hyphen_values = true)]
    pub run_for: Option<Duration>,
}

fn node_id(text: &str) -> Result<u8, String> {
    parse_number(text, 1..=127)
}

/// Reads an ID of MAVLink.
fn from_one(text: &str) -> Result<u8, String> {
    parse_number(text, 1..=u8::MAX)
}

/// Reads a baud rate. No radio is faster than the largest.
fn bandwidth(text: &str) -> Result<u32, String> {
    parse_number(text, 1200..=10_000_000)
}

fn address(text: &str) -> Result<IpAddr, String> {
    text.parse().map_err(|_| String::from("use an address such as 192.168.1.5"))
}

fn status_rate(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(rate) if (1.0..=1000.0).contains(&rate) => Ok(rate),
        _ => Err(String::from("a rate is 1 to 1000 a second; a node must be seen once a second")),
    }
}

fn duration(text: &str) -> Result<Duration, String> {
    sim_base::parse_seconds(text).map(Duration::from_secs_f64)
}

fn info_interval(text: &str) -> Result<Duration, String> {
    let interval = duration(text)?;
    if interval < INFO_INTERVAL_MIN { Err(String::from("at least a second")) } else { Ok(interval) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(line: &str) -> Result<Args, clap::Error> {
        Args::try_parse_from(["bridge"].into_iter().chain(line.split_whitespace()))
    }

    #[test]
    fn the_bus_and_one_channel_are_enough() {
        let args = parse("--bus slcan:/tmp/can --mavlink udpout:127.0.0.1:14550").unwrap();
        assert_eq!((args.system, args.component, args.node_id), (1, 126, None));
    }

    #[test]
    fn invalid_options_are_rejected() {
        for wrong in [
            "",
            "--bus mcast:0",
            "--mavlink udpin:14550",
            "--bus mcast:0 --mavlink udpin:1 --status-rate 0.5",
            "--bus mcast:0 --mavlink udpin:1 --system 0",
            "--bus mcast:0 --mavlink udpin:1 --node-id 128",
            "--bus mcast:0 --mavlink udpin:1 --for 10",
            "--bus mcast:0 --mavlink udpin:1 --for -1s",
            "--bus mcast:0 --mavlink udpin:1 --info-interval 500ms",
            "--bus mcast:0 --mavlink udpin:1 --read-only --autosave",
            "--bus mcast:0 --mavlink udpin:1 --signing-state times",
        ] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
        for (wrong, advice) in [
            ("--system 0", "use a number from 1 to 255"),
            ("--component -1", "use a number from 1 to 255"),
            ("--hide 128", "use a number from 1 to 127"),
            ("--node-id 0", "use a number from 1 to 127"),
            ("--status-rate -1", "a rate is 1 to 1000 a second"),
            ("--bandwidth 0", "use a number from 1200 to 10000000"),
            ("--peer next-door", "use an address such as 192.168.1.5"),
        ] {
            let line = format!("--bus mcast:0 --mavlink udpin:1 {wrong}");
            let error = parse(&line).unwrap_err().to_string();
            assert!(error.contains(advice), "{error}");
        }
        assert!(parse("--bus mcast:0 --names").is_ok());
        let args = parse("--bus mcast:0 --mavlink udpin:1 --for 1h --info-interval 2m").unwrap();
        assert_eq!(
            (args.run_for, args.info_interval),
            (Some(Duration::from_secs(3600)), Duration::from_secs(120))
        );
    }
}
