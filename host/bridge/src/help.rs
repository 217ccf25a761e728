//! `--help`: what most users need in two screens, and the rest by topic.

use crate::args::Args;
use clap::CommandFactory as _;
use dronecan_host::help::{Help, Topic};

/// The help of the bridge.
pub const HELP: Help = Help {
    command: Args::command,
    about: ABOUT,
    common: &[
        "bus",
        "mavlink",
        "bitrate",
        "signing_key",
        "read_only",
        "autosave",
        "names",
        "plain",
    ],
    topics: TOPICS,
    everything: "everything; docs/bridge.md has the messages",
    end: EXAMPLE,
};

const ABOUT: &str = "\
Shows the nodes of a DroneCAN bus to MAVLink ground stations: their names and status. Ground
stations can read, set and save parameters and restart nodes; the DroneCAN GUI Tool can use the
bus itself. A node's MAVLink component ID is its node ID.

Usage: bridge --bus BUS --mavlink CHANNEL [OPTIONS]
";

const BUSES: &str = "\
Buses (--bus):
  slcan:/dev/ttyACM0        SLCAN adapter; slcan:PATH:BAUD where the baud rate matters;
                            \"sim --slcan PATH\" offers one
  mcast:0                   UDP multicast bus of pydronecan, libcanard, ArduPilot SITL and
                            \"sim --mcast 0\", on loopback
  socketcan:can0            a CAN interface of the Linux kernel
";

const CHANNELS: &str = "\
Channels (--mavlink), any number of them:
  udpout:HOST:PORT          sends to a ground station that listens: QGroundControl and MAVProxy
                            on port 14550
  udpin:[ADDRESS:]PORT      listens for ground stations; on loopback unless there is an address
  tcp:HOST:PORT             connects to one that listens, and reconnects
  tcpin:[ADDRESS:]PORT      listens for connections; on loopback unless there is an address
  serial:PATH[:BAUD]        a radio; 57600 baud by default, and no more than that is sent
";

const TUNNELS: &str = "\
A serial port of a node (--tunnel), for any terminal program:
  42:/tmp/port              its default port, as with ArduPilot's nodes
  42:/tmp/port,port=1       another one
  42:/tmp/port,broadcast=0x55
                            a module of Vertiq's
";

const EXAMPLE: &str = "\
Try it without any hardware, in three terminals:
  sim --slcan /tmp/can
  bridge --bus slcan:/tmp/can --mavlink udpout:127.0.0.1:14550
  mavproxy.py --master=udp:127.0.0.1:14550 --target-system=1 --target-component=120
and there \"param show\".
";

const EXIT_CODES: &str = "\
Exit codes:
  0  ended by Ctrl-C, SIGTERM or --for   3  the bus cannot be opened
  1  another error                       4  a channel or a tunnel cannot be opened
  2  the command line is wrong           5  --names: no node, or a node does not send them
";

const TOPICS: &[Topic] = &[
    Topic {
        name: "bus",
        about: "the bus, the bridge's node ID on it, and other programs on it",
        text: || BUSES.into(),
        options: &["bus", "bitrate", "mcast_interface", "node_id", "wait"],
    },
    Topic {
        name: "channels",
        about: "channels to ground stations, and what is sent on them",
        text: || CHANNELS.into(),
        options: &[
            "mavlink",
            "system",
            "component",
            "hide",
            "status_rate",
            "info_interval",
            "bandwidth",
            "mavlink_version",
            "integers",
        ],
    },
    Topic {
        name: "rights",
        about: "who may do what: keys, addresses, read-only",
        text: String::new,
        options: &["signing_key", "signing_state", "peer", "read_only", "allow_can", "autosave"],
    },
    Topic {
        name: "tunnels",
        about: "serial ports of nodes",
        text: || TUNNELS.into(),
        options: &["tunnel"],
    },
    Topic {
        name: "output",
        about: "what is printed, and the end",
        text: || EXIT_CODES.into(),
        options: &["names", "plain", "run_for"],
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_help_fits_two_screens_and_each_option_has_one_topic() {
        HELP.assert_is_whole();
    }
}
