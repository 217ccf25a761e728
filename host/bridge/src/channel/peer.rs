//! The far end of a channel: a ground station, or a link that leads to some.

use super::Transport;
use super::radio::Radio;
use crate::message::{Parser, Writer};
use crate::number::IntegerEncoding;
use crate::queue::Queue;
use mavlink::MavlinkVersion;
use std::io::{self, ErrorKind, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

/// The far end of a channel: a ground station, or a link that leads to some.
pub struct Peer {
    pub name: String,
    /// Address on UDP.
    pub address: Option<SocketAddr>,
    /// Connection on TCP.
    pub stream: Option<TcpStream>,
    pub parser: Parser,
    pub writer: Writer,
    pub queue: Queue,
    /// The rest of a message that was not sent completely.
    pub unsent: Vec<u8>,
    pub heard: Option<MavlinkVersion>,
    pub encoding: IntegerEncoding,
    pub heard_at: Duration,
    /// True if the station has signed a message, or needs no key. The bridge sends nothing to
    /// others.
    pub is_trusted: bool,
    pub sent: u64,
    pub received: u64,
    /// A radio on the way to the station, or a serial port that may lead to one.
    pub radio: Option<Radio>,
}

/// Writes the rest of a message. Returns true if it is complete. Errors are reported by the next
/// read.
pub fn write(transport: &Transport, peer: &mut Peer) -> bool {
    while !peer.unsent.is_empty() {
        let written = match (transport, peer.stream.as_mut(), peer.address) {
            (Transport::Udp(socket), _, Some(address)) => {
                match socket.send_to(&peer.unsent, address) {
                    Err(error) if error.kind() == ErrorKind::WouldBlock => Err(error),
                    // No route or no receiver: the datagram is lost, as on a radio.
                    _ => Ok(peer.unsent.len()),
                }
            }
            (Transport::Serial(port), ..) => {
                rustix::io::write(port, &peer.unsent).map_err(io::Error::from)
            }
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
