//! TCP: one connection that is restored when it is lost, or several accepted connections.

use super::{Channel, PEERS_MAX, Peer, Transport, cannot_listen};
use crate::core::Bridge;
use crate::post::PeerId;
use anyhow::Result;
use rustix::io::Errno;
use socket2::{Domain, Protocol, SockRef, Socket, Type};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

/// Maximum number of connections accepted in one turn.
const ACCEPTED_AT_ONCE: usize = 16;
/// The bridge closes a connection without a signed message after this time. Stations send a
/// heartbeat each second.
const SIGNED_WITHIN: Duration = Duration::from_secs(10);
const CONNECT_FOR: Duration = Duration::from_secs(5);
/// Size of the kernel's send buffer: enough for the throughput, and little enough that statuses are
/// recent.
const SEND_BUFFER: usize = 32 * 1024;

impl Channel {
    pub(super) fn listen(&mut self, local: SocketAddr) -> Result<()> {
        let listener =
            TcpListener::bind(local).map_err(|error| cannot_listen(local, "tcp", error))?;
        listener.set_nonblocking(true)?;
        self.listens_at(listener.local_addr()?);
        self.transport = Transport::Listener(listener);
        Ok(())
    }

    pub(super) fn start_connecting(&mut self, now: Duration, address: SocketAddr) -> Result<()> {
        let socket = Socket::new(Domain::for_address(address), Type::STREAM, Some(Protocol::TCP))?;
        socket.set_nonblocking(true)?;
        match socket.connect(&address.into()) {
            Err(error) if error.raw_os_error() != Some(Errno::INPROGRESS.raw_os_error()) => {
                self.mark_unavailable(now, &error.to_string());
            }
            _ => self.transport = Transport::Connecting(socket, now + CONNECT_FOR),
        }
        Ok(())
    }

    pub(super) fn connect(&mut self, now: Duration, bridge: &mut Bridge, ids: &mut PeerId) {
        match &self.transport {
            Transport::Away(until) if now >= *until => {
                if let Err(error) = self.start(ids, now) {
                    self.mark_unavailable(now, &format!("{error:#}"));
                }
            }
            Transport::LookingUp(look_up) => {
                let Some(found) = look_up.result() else { return };
                match found.and_then(|address| self.start_to(ids, now, address)) {
                    Err(error) => self.mark_unavailable(now, &format!("{error:#}")),
                    Ok(()) if matches!(self.transport, Transport::Udp(_)) => self.mark_available(),
                    Ok(()) => {}
                }
            }
            Transport::Connecting(socket, until) => {
                let trouble = match socket.take_error() {
                    Ok(Some(error)) | Err(error) => Some(error.to_string()),
                    Ok(None) if now >= *until => Some(String::from("no answer")),
                    Ok(None) => None,
                };
                if let Some(trouble) = trouble {
                    return self.mark_unavailable(now, &trouble);
                }
                if socket.peer_addr().is_ok()
                    && let Transport::Connecting(socket, _) =
                        std::mem::replace(&mut self.transport, Transport::Stream)
                {
                    self.mark_available();
                    let name = self.spec.to_string();
                    let id = self.add_stream(ids, now, name, socket.into());
                    bridge.joined(now, id);
                }
            }
            _ => {}
        }
    }

    fn add_stream(
        &mut self,
        ids: &mut PeerId,
        now: Duration,
        name: String,
        stream: TcpStream,
    ) -> PeerId {
        // Errors are ignored: these options only improve the speed.
        let _ = stream.set_nodelay(true);
        let _ = SockRef::from(&stream).set_send_buffer_size(SEND_BUFFER);
        let _ = SockRef::from(&stream).set_keepalive(true);
        let peer = self.peer(name, now);
        self.add(ids, Peer { stream: Some(stream), ..peer })
    }

    pub(super) fn accept(&mut self, now: Duration, bridge: &mut Bridge, ids: &mut PeerId) {
        for _ in 0..ACCEPTED_AT_ONCE {
            let Transport::Listener(listener) = &self.transport else { return };
            let Ok((stream, from)) = listener.accept() else { return };
            if !self.allows(from.ip()) {
                self.refused += 1;
                continue;
            }
            let is_trusted = self.signer.is_none();
            if is_trusted && self.peers.len() >= PEERS_MAX || stream.set_nonblocking(true).is_err()
            {
                self.refuse(now, from);
                continue;
            }
            if !is_trusted {
                self.make_room_for_untrusted(bridge);
            }
            self.log.push(format!("{}: {from} has connected", self.spec));
            let id = self.add_stream(ids, now, from.to_string(), stream);
            if is_trusted {
                bridge.joined(now, id);
            } else if let Some(peer) = self.peers.get_mut(&id) {
                peer.is_trusted = false;
            }
        }
    }

    /// Connections that have not signed do not use up the stations' places: the oldest is closed
    /// for the newest.
    fn make_room_for_untrusted(&mut self, bridge: &mut Bridge) {
        let untrusted: Vec<PeerId> =
            self.peers.iter().filter(|(_, peer)| !peer.is_trusted).map(|(id, _)| *id).collect();
        if untrusted.len() >= PEERS_MAX {
            self.remove(bridge, untrusted[0], "it did not sign");
        }
    }

    /// Closes connections that have not signed in time.
    pub(super) fn close_untrusted(&mut self, now: Duration, bridge: &mut Bridge) {
        let is_late = |peer: &Peer| !peer.is_trusted && now > peer.heard_at + SIGNED_WITHIN;
        self.remove_those(bridge, is_late, "it did not sign");
    }
}
