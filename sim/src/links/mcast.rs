//! The UDP multicast bus of pydronecan, libcanard and ArduPilot SITL, joined to the simulated bus
//! (`--mcast N`).
//!
//! Bus N is the group 239.65.82.N, port 57732. On the simulated bus the link is one more node. It
//! queues the frames of received datagrams and sends them like any node. It sends each frame that
//! it receives as a datagram. It does not receive its own frames, so no frame goes in a circle.
//!
//! Without `--mcast-interface` the link uses loopback, and receives no datagrams of other
//! interfaces. Its sockets never block. When its queue has `QUEUE_LIMIT` frames, it drops and
//! counts new ones, like a full transmit queue.
//!
//! Limits: UDP can lose a datagram, and the sender does not notice it. The multicast bus does not
//! show the times, ACKs and errors of the simulated bus. The link rejects and counts CAN FD frames.

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

/// Most frames in the queue for the simulated bus: the length of pydronecan's transmit queue, 0.15
/// s of a full bus at 1 Mbit/s.
const QUEUE_LIMIT: usize = 1000;
/// Most datagrams received in one call of `serve`, so that a flood cannot block the simulation. A
/// bus carries far fewer meanwhile.
const RECEIVE_MAX: usize = 256;

/// Counters of frames and datagrams.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Counters {
    received: u64,
    sent: u64,
    /// Datagrams with a wrong length, magic, CRC or identifier.
    malformed: u64,
    fd: u64,
    queue_full: u64,
    /// Frames that have no form as a datagram, or that the network did not accept.
    unsent: u64,
}

/// A station on the simulated bus that exchanges its frames with a UDP multicast bus.
pub struct Mcast {
    station: Rc<RefCell<SoftNode>>,
    port: Port,
    counters: Counters,
    last_error: Option<io::ErrorKind>,
}

impl Mcast {
    /// Joins multicast bus `bus` on the interface with address `interface`, by default loopback,
    /// and the simulated bus.
    ///
    /// # Errors
    /// If `interface` is not an address of this computer, or the port is in use; the message says
    /// what to do.
    pub fn open(bus: u8, interface: Option<Ipv4Addr>, bench: &mut Bench) -> Result<Mcast> {
        let port = Port::open(bus, interface)?;
        let station = Rc::new(RefCell::new(SoftNode::new(bench.bus().bit_rate())));
        bench.attach(&format!("mcast:{bus}"), station.clone());
        Ok(Mcast { station, port, counters: Counters::default(), last_error: None })
    }

    fn receive_datagrams(&mut self) {
        for _ in 0..RECEIVE_MAX {
            match self.port.receive() {
                Ok(Some(datagram)) => self.queue_frame(datagram),
                Ok(None) => {}
                Err(error) => return self.keep_error(error),
            }
        }
    }

    fn queue_frame(&mut self, datagram: std::result::Result<Frame, Refused>) {
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

    fn send_datagrams(&mut self) {
        let received = self.station.borrow_mut().take_received();
        for (_, frame) in received {
            match self.port.send(&frame) {
                Ok(true) => self.counters.sent += 1,
                Ok(false) => self.counters.unsent += 1,
                Err(error) => {
                    self.counters.unsent += 1;
                    self.keep_error(error);
                }
            }
        }
    }

    /// Keeps an error for the status line. The simulation goes on, because the interface can come
    /// back.
    fn keep_error(&mut self, error: io::Error) {
        if error.kind() != ErrorKind::WouldBlock {
            self.last_error = Some(error.kind());
        }
    }
}

impl Link for Mcast {
    fn serve(&mut self, _bench: &mut Bench) -> Result<()> {
        self.receive_datagrams();
        self.send_datagrams();
        Ok(())
    }

    fn status(&self) -> String {
        let Counters { received, sent, malformed, fd, queue_full, unsent } = self.counters;
        let (group, interface) = (self.port.group(), self.port.interface());
        let bus = group.ip().octets()[3];
        let mut text = format!("mcast:{bus} at {group} on {interface}: {received} in, {sent} out");
        let errors = [
            (malformed, "malformed"),
            (fd, "CAN FD rejected"),
            (queue_full, "dropped, queue full"),
            (unsent, "not sent"),
        ];
        for (count, what) in errors.into_iter().filter(|(count, _)| *count > 0) {
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
