//! UDP: one given ground station, or several that are known by their datagrams.

use super::{Channel, PEERS_MAX, Peer, READS_AT_ONCE, Spec, Transport, cannot_listen};
use crate::core::Bridge;
use crate::message::{In, Parser, Received, Refused, Request};
use crate::post::PeerId;
use anyhow::{Context as _, Result};
use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::time::Duration;

/// The bridge forgets a station on UDP after this silence. Stations send a heartbeat each second.
const SILENT_FOR: Duration = Duration::from_secs(60);

impl Channel {
    pub(super) fn start_udp_out(
        &mut self,
        ids: &mut PeerId,
        now: Duration,
        address: SocketAddr,
    ) -> Result<()> {
        let local: IpAddr = match address.ip() {
            ip if ip.is_loopback() => ip,
            IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
            IpAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let socket = UdpSocket::bind((local, 0)).context("cannot make a UDP socket")?;
        socket.set_nonblocking(true)?;
        self.transport = Transport::Udp(socket);
        let peer = self.peer(address.to_string(), now);
        self.add(ids, Peer { address: Some(address), ..peer });
        Ok(())
    }

    pub(super) fn start_udp_in(&mut self, local: SocketAddr) -> Result<()> {
        let socket =
            UdpSocket::bind(local).map_err(|error| cannot_listen(local, "udpout", error))?;
        socket.set_nonblocking(true)?;
        self.listens_at(socket.local_addr()?);
        self.transport = Transport::Udp(socket);
        Ok(())
    }

    pub(super) fn receive_datagrams(
        &mut self,
        now: Duration,
        bridge: &mut Bridge,
        ids: &mut PeerId,
    ) {
        let mut buffer = [0; 2048];
        for _ in 0..READS_AT_ONCE * PEERS_MAX {
            let Transport::Udp(socket) = &self.transport else { return };
            let (length, from) = match socket.recv_from(&mut buffer) {
                Ok(received) => received,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                // ICMP reports that the station's port is closed: not an error of this socket.
                Err(_) => continue,
            };
            let known =
                self.peers.iter().find(|(_, peer)| peer.address == Some(from)).map(|(id, _)| *id);
            match known {
                Some(id) => self.take_datagram(now, bridge, id, &buffer[..length]),
                // Only the given station may answer.
                None if matches!(self.spec, Spec::UdpOut(_)) => self.malformed += 1,
                None if !self.allows(from.ip()) => self.refused += 1,
                None => self.handle_unknown_sender(now, bridge, ids, from, &buffer[..length]),
            }
        }
    }

    /// Handles a datagram from an unknown address. The address becomes a peer if the datagram has a
    /// message, signed if there is a key, and there is room. A peer keeps its place while it
    /// sends.
    fn handle_unknown_sender(
        &mut self,
        now: Duration,
        bridge: &mut Bridge,
        ids: &mut PeerId,
        from: SocketAddr,
        bytes: &[u8],
    ) {
        let mut peer = Peer { address: Some(from), ..self.peer(from.to_string(), now) };
        peer.parser.feed(bytes);
        let messages: Vec<Received> = std::iter::from_fn(|| peer.parser.message()).collect();
        let is_of_station = |message: &Received| {
            !matches!(message, Err(_) | Ok((_, In { request: Request::Radio { .. }, .. })))
        };
        if !messages.iter().any(is_of_station) {
            let why = messages.iter().find_map(|message| match message {
                Err(Refused::Signature(why)) => Some(*why),
                _ => None,
            });
            match why {
                Some(why) => self.reject(now, bridge, &mut peer, why),
                None => self.malformed += 1,
            }
            return;
        }
        if self.peers.len() >= PEERS_MAX {
            return self.refuse(now, from);
        }
        let id = self.add(ids, peer);
        self.log.push(format!("{}: {from} has joined", self.spec));
        // Before the answers to its requests.
        bridge.joined(now, id);
        self.take_messages(now, bridge, id, messages);
    }

    /// Except in rare cases a datagram has a whole message, so the bridge does not wait for the
    /// rest of an incomplete one.
    fn take_datagram(&mut self, now: Duration, bridge: &mut Bridge, id: PeerId, bytes: &[u8]) {
        if let Some(peer) = self.peers.get_mut(&id).filter(|_| has_message(bytes)) {
            peer.parser = Parser::new(self.signer.clone());
        }
        self.take(now, bridge, id, bytes);
    }

    pub(super) fn remove_silent(&mut self, now: Duration, bridge: &mut Bridge) {
        if !matches!(self.spec, Spec::UdpIn(_)) {
            return;
        }
        self.remove_those(bridge, |peer| now > peer.heard_at + SILENT_FOR, "silent");
    }
}

/// True if these bytes contain a whole message. Does not check the signature, because no message
/// may be checked twice.
fn has_message(bytes: &[u8]) -> bool {
    let mut parser = Parser::new(None);
    parser.feed(bytes);
    matches!(parser.message(), Some(Ok(_)))
}
