//! The UDP multicast bus of pydronecan, libcanard and ArduPilot SITL, joined to the simulated bus (`--mcast N`).
//!
//! Bus N is the group 239.65.82.N, port 57732; [`datagram`] is the format. To the simulated bus it is one more node:
//! what comes by datagram waits in its queue, arbitrates and is acknowledged like any node's frames, and what it hears
//! from the others goes out as datagrams. What it sends it does not hear, so that nothing goes round in a circle.
//!
//! It stays on loopback unless an interface is given: datagrams of other interfaces are not even received. Sockets never
//! block. Frames beyond [`QUEUE_LIMIT`] are dropped and counted; the newest go, as from a full transmit queue.
//!
//! Limits: UDP promises nothing, so that a datagram may be lost on the way and no sender is told. Time, acknowledgement
//! and errors of the simulated bus do not show on the multicast bus. CAN FD is refused and counted.

mod datagram;

#[cfg(test)]
mod tests;

use super::Link;
use crate::bench::Bench;
use crate::can::SoftNode;
use anyhow::{Context, Result, anyhow};
use datagram::{DATAGRAM_MAX, Refused, decode, encode};
use socket2::{Domain, Protocol, Socket, Type};
use std::cell::RefCell;
use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::rc::Rc;

/// The port of all buses.
const PORT: u16 = 57732;
/// Frames that may wait for the simulated bus: what pydronecan's own transmit queue holds; 0.15 s of a full bus at 1 Mbit/s.
const QUEUE_LIMIT: usize = 1000;
/// Datagrams taken in one call, so that a flood cannot hold up the simulation: far more than a bus carries in its time.
const TAKEN_AT_ONCE: usize = 256;
/// The kernel's buffer: a client's burst must outlast a slice of real time. The kernel may grant less.
const RECEIVE_BUFFER_BYTES: usize = 1 << 20;

/// What passed, and what did not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Counters {
    received: u64,
    sent: u64,
    /// Wrong length, magic, CRC or identifier.
    malformed: u64,
    fd: u64,
    queue_full: u64,
    /// Frames that have no datagram, or that the network did not take.
    unsent: u64,
}

/// A station on the simulated bus that is the UDP multicast bus of this host.
pub struct Mcast {
    station: Rc<RefCell<SoftNode>>,
    group: SocketAddrV4,
    interface: Ipv4Addr,
    receiver: UdpSocket,
    sender: UdpSocket,
    /// Our datagrams come back from here.
    own: SocketAddr,
    counters: Counters,
    last_error: Option<io::ErrorKind>,
}

impl Mcast {
    /// Joins multicast bus `bus` on the interface with that address, loopback unless given, and the simulated bus.
    ///
    /// # Errors
    /// With advice, when the address is not of this machine or the port is taken.
    pub fn open(bus: u8, interface: Option<Ipv4Addr>, bench: &mut Bench) -> Result<Mcast> {
        let group = SocketAddrV4::new(Ipv4Addr::new(239, 65, 82, bus), PORT);
        let interface = interface.unwrap_or(Ipv4Addr::LOCALHOST);
        let receiver = receiver(group, interface)?;
        let sender = sender(interface)?;
        let own = sender.local_addr().context("the multicast sender has no address")?;
        let station = Rc::new(RefCell::new(SoftNode::new(bench.bus().bit_rate())));
        bench.attach(&format!("mcast:{bus}"), station.clone());
        Ok(Mcast { station, group, interface, receiver, sender, own, counters: Counters::default(), last_error: None })
    }

    fn take_datagrams(&mut self) {
        // One byte more, so that a longer datagram is not cut to a valid length.
        let mut buffer = [0; DATAGRAM_MAX + 1];
        for _ in 0..TAKEN_AT_ONCE {
            match self.receiver.recv_from(&mut buffer) {
                Ok((_, from)) if from == self.own => {}
                Ok((length, _)) => self.take_datagram(&buffer[..length]),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return self.note(error),
            }
        }
    }

    fn take_datagram(&mut self, datagram: &[u8]) {
        match decode(datagram) {
            Ok(_) if self.station.borrow().queued() >= QUEUE_LIMIT => self.counters.queue_full += 1,
            Ok(frame) => {
                self.counters.received += 1;
                self.station.borrow_mut().send(frame);
            }
            Err(Refused::Fd) => self.counters.fd += 1,
            Err(_) => self.counters.malformed += 1,
        }
    }

    fn send_heard(&mut self) {
        let heard = self.station.borrow_mut().take_received();
        for (_, frame) in heard {
            let sent = encode(&frame).map(|datagram| self.sender.send_to(&datagram, self.group));
            match sent {
                Some(Ok(_)) => self.counters.sent += 1,
                None => self.counters.unsent += 1,
                Some(Err(error)) => {
                    self.counters.unsent += 1;
                    self.note(error);
                }
            }
        }
    }

    /// An interface may come and go: what went wrong is shown, and the simulation goes on.
    fn note(&mut self, error: io::Error) {
        if error.kind() != ErrorKind::WouldBlock {
            self.last_error = Some(error.kind());
        }
    }
}

impl Link for Mcast {
    fn serve(&mut self, _bench: &mut Bench) -> Result<()> {
        self.take_datagrams();
        self.send_heard();
        Ok(())
    }

    fn status(&self) -> String {
        let Counters { received, sent, malformed, fd, queue_full, unsent } = self.counters;
        let bus = self.group.ip().octets()[3];
        let mut text = format!("mcast:{bus} at {} on {}: {received} in, {sent} out", self.group, self.interface);
        let troubles = [
            (malformed, "malformed"),
            (fd, "CAN FD refused"),
            (queue_full, "dropped, queue full"),
            (unsent, "not sent"),
        ];
        for (count, what) in troubles.into_iter().filter(|(count, _)| *count > 0) {
            text += &format!(", {count} {what}");
        }
        if let Some(error) = self.last_error {
            text += &format!(", last error: {error}");
        }
        if let Some(advice) = advice(self.group, self.interface) {
            text += &format!(" ({advice})");
        }
        text
    }

    fn needs_real_time(&self) -> bool {
        true
    }
}

/// Hears the group, on this interface only, next to other programs of this machine.
fn receiver(group: SocketAddrV4, interface: Ipv4Addr) -> Result<UdpSocket> {
    let open = || -> io::Result<Socket> {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
        socket.set_reuse_address(true)?;
        socket.set_nonblocking(true)?;
        socket.set_recv_buffer_size(RECEIVE_BUFFER_BYTES)?;
        // Without this Linux passes on what comes in by interfaces that other programs have joined on.
        socket.set_multicast_all_v4(false)?;
        Ok(socket)
    };
    let socket = open().context("cannot make a UDP socket")?;
    socket.bind(&SocketAddr::from(group).into()).map_err(|error| match error.kind() {
        ErrorKind::AddrInUse => anyhow!(
            "{group} is in use by a program that does not share it; find it with \"ss -ulpn\", or choose another bus"
        ),
        _ => anyhow!(error).context(format!("cannot listen to {group}")),
    })?;
    socket.join_multicast_v4(group.ip(), &interface).map_err(|error| no_such_interface(interface, error))?;
    Ok(socket.into())
}

/// Sends from a port of its own, by which our datagrams are told from those of others.
fn sender(interface: Ipv4Addr) -> Result<UdpSocket> {
    let open = || -> io::Result<Socket> {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
        socket.set_nonblocking(true)?;
        socket.bind(&SocketAddr::from((interface, 0)).into())?;
        // No route is needed then, and none can lead elsewhere.
        socket.set_multicast_if_v4(&interface)?;
        Ok(socket)
    };
    Ok(open().map_err(|error| no_such_interface(interface, error))?.into())
}

fn no_such_interface(interface: Ipv4Addr, error: io::Error) -> anyhow::Error {
    let remedy = match interface {
        Ipv4Addr::LOCALHOST => String::from("is loopback up? \"ip link set lo up\""),
        _ => String::from("is it an address of this machine? \"ip -4 address\" lists them"),
    };
    anyhow!(error).context(format!("cannot join the multicast bus on {interface}; {remedy}"))
}

/// Other programs leave the choice of the interface to the routes: what a user must do if that is not ours.
fn advice(group: SocketAddrV4, interface: Ipv4Addr) -> Option<String> {
    let route = || -> io::Result<SocketAddr> {
        let probe = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        // Nothing is sent: this only asks for the route.
        probe.connect(group)?;
        probe.local_addr()
    };
    let elsewhere = match route() {
        Ok(local) if local.ip() == interface => return None,
        // Linux finds no source address for a route that leads to loopback, and does without.
        Ok(local) if local.ip().is_unspecified() && interface.is_loopback() => return None,
        Ok(local) => format!("other programs speak on {}", local.ip()),
        Err(_) => String::from("other programs find no route for multicast"),
    };
    Some(match interface {
        Ipv4Addr::LOCALHOST => format!("{elsewhere}: \"ip route add 239.65.82.0/24 dev lo\" lets them in"),
        _ => format!("{elsewhere}: set their IP_MULTICAST_IF to {interface}, or a route for 239.65.82.0/24"),
    })
}
