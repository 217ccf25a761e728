//! The far end of a channel: a ground station, or what leads to some.

use super::Transport;
use crate::message::{Parser, Writer};
use crate::number::Custom;
use crate::queue::Queue;
use mavlink::MavlinkVersion;
use std::io::{self, ErrorKind, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

/// The far end of a channel.
pub struct Peer {
    pub name: String,
    /// On UDP.
    pub address: Option<SocketAddr>,
    /// On TCP.
    pub stream: Option<TcpStream>,
    pub parser: Parser,
    pub writer: Writer,
    pub queue: Queue,
    /// Of a message that was not taken whole.
    pub unsent: Vec<u8>,
    pub heard: Option<MavlinkVersion>,
    pub custom: Custom,
    pub heard_at: Duration,
    /// The station has shown that it has the key, or needs none. The bridge sends nothing to others.
    pub is_trusted: bool,
    pub sent: u64,
    pub received: u64,
}

/// Writes the rest of a message; true if that was all. A read reports errors.
pub fn write(transport: &Transport, peer: &mut Peer) -> bool {
    while !peer.unsent.is_empty() {
        let written = match (transport, peer.stream.as_mut(), peer.address) {
            (Transport::Udp(socket), _, Some(address)) => {
                match socket.send_to(&peer.unsent, address) {
                    Err(error) if error.kind() == ErrorKind::WouldBlock => Err(error),
                    // No route, or no receiver: lost, as on a radio.
                    _ => Ok(peer.unsent.len()),
                }
            }
            (Transport::Serial(port), ..) => rustix::io::write(port, &peer.unsent).map_err(io::Error::from),
            (_, Some(stream), _) => stream.write(&peer.unsent),
            _ => Ok(peer.unsent.len()),
        };
        match written {
            Ok(length) => drop(peer.unsent.drain(..length)),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => return false,
            Err(_) => peer.unsent.clear(),
        }
    }
    true
}
