//! The UDP multicast bus of pydronecan, libcanard and ArduPilot SITL, joined to the simulated bus (`--mcast N`).
//!
//! Bus N is the group 239.65.82.N, port 57732. To the simulated bus it is one more node:
//! what comes by datagram waits in its queue, arbitrates and is acknowledged like any node's frames, and what it hears
//! from the others goes out as datagrams. What it sends it does not hear, so that nothing goes round in a circle.
//!
//! It stays on loopback unless an interface is given: datagrams of other interfaces are not even received. Sockets never
//! block. Frames beyond `QUEUE_LIMIT` are dropped and counted; the newest go, as from a full transmit queue.
//!
//! Limits: UDP may lose a datagram, and the sender does not notice it. Time, acknowledgement
//! and errors of the simulated bus do not show on the multicast bus. CAN FD is refused and counted.

#[cfg(test)]
mod tests;

use super::Link;
use anyhow::Result;
use bench::Bench;
use bench::can::{Frame, SoftNode};
use bench::dronecan::mcast::{Port, datagram::Refused};
use std::cell::RefCell;
use std::io::{self, ErrorKind};
use std::net::Ipv4Addr;
use std::rc::Rc;

/// Frames that may wait for the simulated bus: what pydronecan's own transmit queue holds; 0.15 s of a full bus at 1 Mbit/s.
const QUEUE_LIMIT: usize = 1000;
/// Datagrams taken in one call, so that a flood cannot hold up the simulation: far more than a bus carries in its time.
const TAKEN_AT_ONCE: usize = 256;

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
    port: Port,
    counters: Counters,
    last_error: Option<io::ErrorKind>,
}

impl Mcast {
    /// Joins multicast bus `bus` on the interface with that address, loopback unless given, and the simulated bus.
    ///
    /// # Errors
    /// With advice, when the address is not of this machine or the port is taken.
    pub fn open(bus: u8, interface: Option<Ipv4Addr>, bench: &mut Bench) -> Result<Mcast> {
        let port = Port::open(bus, interface)?;
        let station = Rc::new(RefCell::new(SoftNode::new(bench.bus().bit_rate())));
        bench.attach(&format!("mcast:{bus}"), station.clone());
        Ok(Mcast { station, port, counters: Counters::default(), last_error: None })
    }

    fn take_datagrams(&mut self) {
        for _ in 0..TAKEN_AT_ONCE {
            match self.port.receive() {
                Ok(Some(datagram)) => self.take_datagram(datagram),
                Ok(None) => {}
                Err(error) => return self.note(error),
            }
        }
    }

    fn take_datagram(&mut self, datagram: std::result::Result<Frame, Refused>) {
        match datagram {
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
            match self.port.send(&frame) {
                Ok(true) => self.counters.sent += 1,
                Ok(false) => self.counters.unsent += 1,
                Err(error) => {
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
        let (group, interface) = (self.port.group(), self.port.interface());
        let bus = group.ip().octets()[3];
        let mut text = format!("mcast:{bus} at {group} on {interface}: {received} in, {sent} out");
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
        if let Some(advice) = self.port.advice() {
            text += &format!(" ({advice})");
        }
        text
    }

    fn needs_real_time(&self) -> bool {
        true
    }
}
