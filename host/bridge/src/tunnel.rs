//! Serial ports over the bus: tunnel.Targetted, as ArduPilot's nodes and the DroneCAN GUI Tool use
//! it, or tunnel.Broadcast.
//!
//! Bytes that a program writes to the pseudo-terminal ([`crate::pty`]) go to one node, and the
//! node's bytes come out of it. A node answers the last sender for three seconds, so the bridge
//! sends an empty message each half second.
//!
//! The bridge sends no more than a serial line of the baud rate can carry, because the node passes
//! the bytes on to such a line.

use dronecan_host::tunnel::{BROADCAST_MAX, DEFAULT_PORT, GPS_GENERIC, LOCK_PORT, TARGETTED_MAX};
use dronecan_host::{
    CanId, DataType, Frame, NodeId, Transfer, TransferId, TunnelBroadcast, TunnelTargetted, types,
};
use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

/// Period of empty messages: half that of ArduPilot's tools, and well within the three seconds of
/// its nodes.
const KEEPALIVE_PERIOD: Duration = Duration::from_millis(500);
/// Maximum number of bytes that wait for the bus. At this number the bridge stops reading the
/// pseudo-terminal.
const WAITING_MAX: usize = 4096;
/// A middle priority: below commands and statuses.
const PRIORITY: u8 = 20;
/// Start bit, eight data bits, stop bit.
const BITS_PER_BYTE: f64 = 10.0;
/// tunnel.Targetted has 24 bits for the baud rate.
const BAUD_RATE_MAX: u32 = (1 << 24) - 1;

/// The message that carries the bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    Targetted { serial_port: i8, locks: bool },
    Broadcast { protocol: u8 },
}

/// A tunnel as the user writes it: `NODE:PTY`, with options after commas.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Spec {
    pub node: NodeId,
    pub path: PathBuf,
    pub way: Way,
}

const EXAMPLES: &str =
    "write for example 42:/tmp/port, 42:/tmp/port,port=1,lock or 42:/tmp/port,broadcast=0x55";

impl FromStr for Spec {
    type Err = String;

    fn from_str(text: &str) -> Result<Spec, String> {
        let (node, rest) = text.split_once(':').ok_or(EXAMPLES)?;
        let node = node
            .parse()
            .ok()
            .and_then(NodeId::new)
            .ok_or_else(|| format!("\"{node}\" is not a node ID; {EXAMPLES}"))?;
        let mut words = rest.split(',');
        let path = words.next().filter(|path| !path.is_empty()).ok_or(EXAMPLES)?;
        let mut way = Way::Targetted { serial_port: DEFAULT_PORT, locks: false };
        for word in words {
            way = match (word.split_once('=').unwrap_or((word, "")), way) {
                (("lock", ""), Way::Targetted { serial_port, .. }) => {
                    Way::Targetted { serial_port, locks: true }
                }
                (("port", number), Way::Targetted { locks, .. }) => match number.parse() {
                    Ok(serial_port @ 0..=15) => Way::Targetted { serial_port, locks },
                    _ => {
                        return Err(format!(
                            "\"{number}\" is not a serial port of a node: 0 to 15"
                        ));
                    }
                },
                (
                    ("broadcast", protocol),
                    Way::Targetted { serial_port: DEFAULT_PORT, locks: false },
                ) => Way::Broadcast { protocol: byte(protocol)? },
                _ => return Err(format!("\"{word}\" is not an option here; {EXAMPLES}")),
            };
        }
        Ok(Spec { node, path: path.into(), way })
    }
}

fn byte(text: &str) -> Result<u8, String> {
    let parsed = match text.strip_prefix("0x") {
        Some(digits) => u8::from_str_radix(digits, 16),
        None => text.parse(),
    };
    parsed.map_err(|_| format!("\"{text}\" is not a protocol: 0 to 255, or 0x00 to 0xFF"))
}

struct Tunnel {
    node: NodeId,
    way: Way,
    baud_rate: u32,
    waiting: VecDeque<u8>,
    /// When a serial line would have carried the bytes sent so far.
    free_at: Duration,
    next_keep_alive: Duration,
}

/// All tunnels.
pub struct Tunnels {
    own: NodeId,
    all: Vec<Tunnel>,
    /// Transfer ID of each message type; all tunnels share it.
    counters: BTreeMap<u16, TransferId>,
    /// Received bytes, with the number of the tunnel.
    received: Vec<(usize, Vec<u8>)>,
}

impl Tunnels {
    pub fn new(own: NodeId, specs: &[Spec]) -> Tunnels {
        let tunnel = |spec: &Spec| Tunnel {
            node: spec.node,
            way: spec.way,
            baud_rate: 115_200,
            waiting: VecDeque::new(),
            free_at: Duration::ZERO,
            next_keep_alive: Duration::ZERO,
        };
        Tunnels {
            own,
            all: specs.iter().map(tunnel).collect(),
            counters: BTreeMap::new(),
            received: Vec::new(),
        }
    }

    /// True if bytes from the pseudo-terminal can be queued.
    pub fn has_room(&self, at: usize) -> bool {
        self.all.get(at).is_some_and(|tunnel| tunnel.waiting.len() < WAITING_MAX)
    }

    /// Queues bytes from the pseudo-terminal, whose baud rate is `baud_rate`.
    pub fn write(&mut self, at: usize, baud_rate: u32, bytes: &[u8]) {
        if let Some(tunnel) = self.all.get_mut(at) {
            tunnel.baud_rate = baud_rate.clamp(1, BAUD_RATE_MAX);
            tunnel.waiting.extend(bytes);
        }
    }

    /// Takes the bytes for the pseudo-terminals, with the numbers of their tunnels.
    pub fn take_received(&mut self) -> Vec<(usize, Vec<u8>)> {
        std::mem::take(&mut self.received)
    }

    /// True if a message may be for a tunnel.
    pub fn wants(&self, type_id: u16, source: NodeId) -> bool {
        self.all.iter().any(|tunnel| tunnel.node == source && tunnel.data_type().id == type_id)
    }

    /// Handles a message for which [`Tunnels::wants`] was true.
    pub fn receive(&mut self, transfer: &Transfer) {
        let CanId::Message { type_id, source, .. } = transfer.id else { return };
        for (at, tunnel) in self.all.iter().enumerate().filter(|(_, tunnel)| tunnel.node == source)
        {
            let buffer = match tunnel.way {
                Way::Targetted { serial_port, .. } if type_id == types::TUNNEL_TARGETTED.id => {
                    // The node sends the number of its port, even if the bridge requested the
                    // default port.
                    let of_port = |number: i8| serial_port == DEFAULT_PORT || number == serial_port;
                    TunnelTargetted::decode(&transfer.payload)
                        .filter(|message| {
                            message.target == self.own && of_port(message.serial_port)
                        })
                        .map(|message| message.buffer)
                }
                Way::Broadcast { protocol } if type_id == types::TUNNEL_BROADCAST.id => {
                    let message = TunnelBroadcast::decode(&transfer.payload);
                    message
                        .filter(|message| message.protocol == protocol)
                        .map(|message| message.buffer)
                }
                _ => None,
            };
            self.received
                .extend(buffer.filter(|buffer| !buffer.is_empty()).map(|buffer| (at, buffer)));
        }
    }

    /// Sends the messages that are due.
    pub fn poll(&mut self, now: Duration, frames: &mut Vec<Frame>) {
        for tunnel in &mut self.all {
            let Some((data_type, payload)) = tunnel.next(now) else { continue };
            let transfer_id = self.counters.entry(data_type.id).or_default().advance();
            frames.extend(dronecan_host::frames(
                data_type.message_id(PRIORITY, self.own),
                &payload,
                transfer_id,
            ));
        }
    }

    /// When [`Tunnels::poll`] must be called next.
    pub fn deadline(&self) -> Option<Duration> {
        self.all.iter().filter_map(Tunnel::deadline).min()
    }
}

impl Tunnel {
    fn data_type(&self) -> DataType {
        match self.way {
            Way::Targetted { .. } => types::TUNNEL_TARGETTED,
            Way::Broadcast { .. } => types::TUNNEL_BROADCAST,
        }
    }

    /// The next message, if one is due.
    fn next(&mut self, now: Duration) -> Option<(DataType, Vec<u8>)> {
        if now < self.free_at {
            return None;
        }
        let most =
            if matches!(self.way, Way::Broadcast { .. }) { BROADCAST_MAX } else { TARGETTED_MAX };
        let buffer: Vec<u8> = self.waiting.drain(..self.waiting.len().min(most)).collect();
        // Only a node that is addressed by its ID needs empty messages.
        let is_kept_alive =
            matches!(self.way, Way::Targetted { .. }) && now >= self.next_keep_alive;
        if buffer.is_empty() && !is_kept_alive {
            return None;
        }
        self.next_keep_alive = now + KEEPALIVE_PERIOD;
        self.free_at = now
            + Duration::from_secs_f64(
                buffer.len() as f64 * BITS_PER_BYTE / f64::from(self.baud_rate),
            );
        let payload = match self.way {
            Way::Targetted { serial_port, locks } => TunnelTargetted {
                protocol: GPS_GENERIC,
                target: self.node,
                serial_port,
                options: if locks { LOCK_PORT } else { 0 },
                baud_rate: self.baud_rate,
                buffer,
            }
            .encode(),
            Way::Broadcast { protocol } => {
                TunnelBroadcast { protocol, channel: 0, buffer }.encode()
            }
        };
        Some((self.data_type(), payload))
    }

    fn deadline(&self) -> Option<Duration> {
        match (self.waiting.is_empty(), self.way) {
            (false, _) => Some(self.free_at),
            (true, Way::Targetted { .. }) => Some(self.next_keep_alive),
            (true, Way::Broadcast { .. }) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tunnel_specs_have_the_syntax_of_the_help() {
        let way =
            |text: &str| text.parse::<Spec>().map(|spec| (spec.node.get(), spec.path, spec.way));
        let path = PathBuf::from("/tmp/port");
        assert_eq!(
            way("42:/tmp/port"),
            Ok((42, path.clone(), Way::Targetted { serial_port: -1, locks: false }))
        );
        let locked = Way::Targetted { serial_port: 1, locks: true };
        assert_eq!(way("42:/tmp/port,port=1,lock"), Ok((42, path.clone(), locked)));
        assert_eq!(
            way("42:/tmp/port,broadcast=0x55"),
            Ok((42, path, Way::Broadcast { protocol: 0x55 }))
        );
        let wrong = "42 42: 0:/x 128:/x 42:/x,port=16 42:/x,broadcast=256 42:/x,lock,broadcast=1";
        for wrong in wrong.split(' ').chain([""]) {
            assert!(wrong.parse::<Spec>().is_err(), "{wrong}");
        }
    }

    /// 960 bytes at 9600 baud take a second.
    #[test]
    fn a_tunnel_sends_no_more_than_its_baud_rate() {
        let own = NodeId::new(126).unwrap();
        let mut tunnels = Tunnels::new(own, &["42:/x".parse().unwrap()]);
        tunnels.write(0, 9600, &[b'x'; 2400]);
        let mut frames = Vec::new();
        for ms in 0..1000 {
            tunnels.poll(Duration::from_millis(ms), &mut frames);
        }
        // 960 bytes are 8 messages of 120 bytes, with 19 frames each. The first is sent at once.
        assert!((8 * 19..=9 * 19).contains(&frames.len()), "{}", frames.len());
    }
}
