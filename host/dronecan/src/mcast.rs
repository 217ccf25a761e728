//! The UDP multicast bus of pydronecan, libcanard and ArduPilot SITL.
//!
//! Bus N is the group 239.65.82.N, port 57732; [`datagram`] is the format. A [`Port`] uses one
//! interface, loopback by default, and receives no datagrams of other interfaces. It never blocks.
//!
//! Limits: UDP may lose a datagram without an error at the sender.

pub mod datagram;

use crate::Frame;
use anyhow::{Context, Result, anyhow};
use datagram::{DATAGRAM_MAX, Refused, decode, encode};
use socket2::{Domain, Protocol, Socket, Type};
use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};

/// The UDP port of all buses.
const UDP_PORT: u16 = 57732;
/// The kernel's receive buffer, for bursts while the program is busy. The kernel may grant less.
const RECEIVE_BUFFER_BYTES: usize = 1 << 20;

/// A socket on one of the buses.
pub struct Port {
    group: SocketAddrV4,
    interface: Ipv4Addr,
    receiver: UdpSocket,
    sender: UdpSocket,
    /// The address from which our own datagrams come back.
    own: SocketAddr,
}

impl Port {
    /// Joins bus `bus` on the interface with this address, by default loopback.
    ///
    /// # Errors
    /// If the address is not of this machine or the UDP port is in use. The error has a remedy.
    pub fn open(bus: u8, interface: Option<Ipv4Addr>) -> Result<Port> {
        let group = SocketAddrV4::new(Ipv4Addr::new(239, 65, 82, bus), UDP_PORT);
        let interface = interface.unwrap_or(Ipv4Addr::LOCALHOST);
        let receiver = receiver(group, interface)?;
        let sender = sender(interface)?;
        let own = sender.local_addr().context("the multicast sender has no address")?;
        Ok(Port { group, interface, receiver, sender, own })
    }

    /// The frame in the next datagram of another program, or why it has none. `None` for our own
    /// datagrams.
    ///
    /// # Errors
    /// `WouldBlock` if there is no datagram; other errors come from the network.
    pub fn receive(&self) -> io::Result<Option<std::result::Result<Frame, Refused>>> {
        // One byte more, so that a longer datagram is not truncated to a valid length.
        let mut buffer = [0; DATAGRAM_MAX + 1];
        match self.receiver.recv_from(&mut buffer) {
            Ok((_, from)) if from == self.own => Ok(None),
            Ok((length, _)) => Ok(Some(decode(&buffer[..length]))),
            Err(error) if error.kind() == ErrorKind::Interrupted => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Sends a frame. Returns `false` for remote frames, which the format does not have.
    ///
    /// # Errors
    /// Errors of the network.
    pub fn send(&self, frame: &Frame) -> io::Result<bool> {
        match encode(frame) {
            Some(datagram) => self.sender.send_to(&datagram, self.group).map(|_| true),
            None => Ok(false),
        }
    }

    /// Address of the bus.
    pub fn group(&self) -> SocketAddrV4 {
        self.group
    }

    /// Address of the interface.
    pub fn interface(&self) -> Ipv4Addr {
        self.interface
    }

    /// What the user must do if other programs, which let the routes choose the interface, use
    /// another one.
    pub fn advice(&self) -> Option<String> {
        let Port { group, interface, .. } = *self;
        let route = || -> io::Result<SocketAddr> {
            let probe = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
            // This sends nothing: it only asks for the route.
            probe.connect(group)?;
            probe.local_addr()
        };
        let elsewhere = match route() {
            Ok(local) if local.ip() == interface => return None,
            // Linux finds no source address for a route to loopback, and needs none.
            Ok(local) if local.ip().is_unspecified() && interface.is_loopback() => return None,
            Ok(local) => format!("other programs speak on {}", local.ip()),
            Err(_) => String::from("other programs find no route for multicast"),
        };
        Some(match interface {
            Ipv4Addr::LOCALHOST => {
                format!(
                    "{elsewhere}: \"ip route add 239.65.82.0/24 dev lo src 127.0.0.1\" lets \
                     them in"
                )
            }
            _ => format!(
                "{elsewhere}: set their IP_MULTICAST_IF to {interface}, or a route for \
                 239.65.82.0/24"
            ),
        })
    }
}

/// Readable if there may be a datagram.
impl AsFd for Port {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.receiver.as_fd()
    }
}

/// A socket that receives the group on this interface only, and shares the port with other programs
/// of this machine.
fn receiver(group: SocketAddrV4, interface: Ipv4Addr) -> Result<UdpSocket> {
    let open = || -> io::Result<Socket> {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
        socket.set_reuse_address(true)?;
        socket.set_nonblocking(true)?;
        socket.set_recv_buffer_size(RECEIVE_BUFFER_BYTES)?;
        // Otherwise Linux also delivers datagrams from interfaces that other programs have joined
        // on.
        socket.set_multicast_all_v4(false)?;
        Ok(socket)
    };
    let socket = open().context("cannot make a UDP socket")?;
    socket.bind(&SocketAddr::from(group).into()).map_err(|error| match error.kind() {
        ErrorKind::AddrInUse => anyhow!(
            "{group} is in use by a program that does not share it; find it with \"ss -ulpn\", or \
             choose another bus"
        ),
        _ => anyhow!(error).context(format!("cannot listen to {group}")),
    })?;
    socket
        .join_multicast_v4(group.ip(), &interface)
        .map_err(|error| no_such_interface(interface, error))?;
    Ok(socket.into())
}

/// A socket with its own port, which identifies its own datagrams.
fn sender(interface: Ipv4Addr) -> Result<UdpSocket> {
    let open = || -> io::Result<Socket> {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
        socket.set_nonblocking(true)?;
        socket.bind(&SocketAddr::from((interface, 0)).into())?;
        // With this no route is needed, and none can lead elsewhere.
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
