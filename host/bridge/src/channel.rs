//! MAVLink channels: UDP, TCP or a serial port, and the ground stations at their other ends.
//!
//! A channel has one far end (`udpout`, `tcp`, `serial`) or several (`udpin`, `tcpin`). Each is a
//! [`Peer`] with its own queue, its own version of MAVLink and its own sequence numbers. Nothing
//! blocks: messages that a channel does not accept wait in the queue, which drops
//! the least important. If the rate of a channel is known, the bridge sends no more than that, so
//! that important messages do not wait behind others. A [`radio`] on the way sets the pace of its
//! station.

mod budget;
mod peer;
mod radio;
mod receive;
mod rejected;
mod report;
mod resolve;
mod serial;
mod spec;
mod tcp;
mod udp;

#[cfg(test)]
mod tests;

use crate::core::Bridge;
use crate::message::{Parser, Versions, Writer};
use crate::number::IntegerEncoding;
use crate::post::{PeerId, Post, To};
use crate::queue::Queue;
use crate::signing::{Signer, Signing};
use anyhow::{Result, anyhow};
use serial2::SerialPort;
use socket2::Socket;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::net::{IpAddr, SocketAddr, TcpListener, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};
use std::rc::Rc;
use std::time::Duration;

use budget::Budget;
use peer::{Peer, write};
use radio::Radio;
use rejected::Rejected;
use resolve::{LookUp, resolve};
pub use spec::Spec;

/// Maximum number of ground stations at one open port.
const PEERS_MAX: usize = 16;
/// Time between two log lines about rejected stations.
const REJECTION_LOGGED_AFTER: Duration = Duration::from_secs(60);
const RETRY: Duration = Duration::from_secs(1);
/// Maximum number of reads from each peer in one turn.
const READS_AT_ONCE: usize = 64;
/// The component ID of MAVProxy. MAVProxy reads integers as floats unless component 1 is a PX4.
const MAVPROXY: u8 = 230;

/// The encoding of integers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Integers {
    /// Their bytes; to MAVProxy, which reads floats, as floats
    #[default]
    Auto,
    /// Their bytes, as PX4 does
    Bytes,
    /// As floats of the same value, as ArduPilot does
    Cast,
}

/// Settings of all channels.
#[derive(Clone)]
pub struct Options {
    pub system: u8,
    pub versions: Versions,
    pub integers: Integers,
    /// Minimum time between two statuses of a node.
    pub status_interval: Duration,
    /// Highest rate of a channel, in bytes a second.
    pub byte_rate: Option<f64>,
    /// Key and timestamps of signatures, of all channels.
    pub signing: Option<Rc<RefCell<Signing>>>,
    /// Addresses that listeners accept; if empty, all.
    pub allowed: Vec<IpAddr>,
}

enum Transport {
    Udp(UdpSocket),
    Listener(TcpListener),
    /// The host name is being resolved.
    LookingUp(LookUp),
    Connecting(Socket, Duration),
    Stream,
    Serial(SerialPort),
    /// Not available; the next attempt is at this time.
    Away(Duration),
}

/// A channel, open or not.
pub struct Channel {
    spec: Spec,
    options: Options,
    signer: Option<Signer>,
    transport: Transport,
    peers: BTreeMap<PeerId, Peer>,
    budget: Option<Budget>,
    malformed: u64,
    /// Datagrams and connections from addresses that are not allowed, or for which there was no
    /// room.
    refused: u64,
    refusal_logged_at: Option<Duration>,
    rejected: Rejected,
    /// Messages that the queues of former peers dropped.
    dropped: u64,
    is_loss_logged: bool,
    pub log: Vec<String>,
}

impl Channel {
    /// Opens the `number`th channel.
    ///
    /// # Errors
    /// If a retry would not help, or without `wait`: a port in use, an unknown host, no serial
    /// port. The error has a remedy.
    pub fn open(
        spec: Spec,
        number: usize,
        options: Options,
        ids: &mut PeerId,
        now: Duration,
        wait: bool,
    ) -> Result<Channel> {
        let signer = options.signing.clone().map(|signing| Signer::new(signing, number as u8));
        let rate = match &spec {
            Spec::Serial { baud, .. } => {
                let carried = byte_rate(*baud);
                Some(options.byte_rate.map_or(carried, |limit| limit.min(carried)))
            }
            _ => options.byte_rate,
        };
        let mut channel = Channel {
            spec,
            options,
            signer,
            transport: Transport::Away(now),
            peers: BTreeMap::new(),
            budget: rate.map(Budget::new),
            malformed: 0,
            refused: 0,
            refusal_logged_at: None,
            rejected: Rejected::default(),
            dropped: 0,
            is_loss_logged: false,
            log: Vec::new(),
        };
        channel.warn_about_open_listener();
        let started = match (&channel.spec, wait) {
            // Nothing else is in the queue yet.
            (Spec::UdpOut(remote) | Spec::TcpOut(remote), false) => {
                resolve(&remote.clone()).and_then(|address| channel.start_to(ids, now, address))
            }
            _ => channel.start(ids, now),
        };
        match started {
            Err(error) if !wait => Err(error),
            Err(error) => {
                channel.mark_unavailable(now, &format!("{error:#}"));
                Ok(channel)
            }
            Ok(()) => Ok(channel),
        }
    }

    /// Warns if the channel listens beyond this machine without a key: it accepts commands from
    /// every station that reaches it.
    fn warn_about_open_listener(&mut self) {
        let (Spec::UdpIn(local) | Spec::TcpIn(local)) = self.spec else { return };
        if !local.ip().is_loopback() && self.signer.is_none() {
            let spec = &self.spec;
            self.log.push(format!(
                "{spec} has no key: whoever can reach it can command the nodes; give a \
                 --signing-key"
            ));
        }
    }

    /// Stores and logs the port that the system chose for port 0.
    fn listens_at(&mut self, local: SocketAddr) {
        let (Spec::UdpIn(given) | Spec::TcpIn(given)) = &mut self.spec else { return };
        if given.port() == 0 {
            *given = local;
            self.log.push(format!("{} is open: the system chose the port", self.spec));
        }
    }

    fn start(&mut self, ids: &mut PeerId, now: Duration) -> Result<()> {
        match self.spec.clone() {
            Spec::UdpOut(remote) | Spec::TcpOut(remote) => match remote.parse() {
                // A serial port needs no host name.
                Ok(address) => self.start_to(ids, now, address)?,
                Err(_) => self.transport = Transport::LookingUp(LookUp::begin(remote)),
            },
            Spec::UdpIn(local) => self.start_udp_in(local)?,
            Spec::TcpIn(local) => self.listen(local)?,
            Spec::Serial { path, baud } => self.start_serial(ids, now, &path, baud)?,
        }
        Ok(())
    }

    /// Opens the channel when the address of the far end is known.
    fn start_to(&mut self, ids: &mut PeerId, now: Duration, address: SocketAddr) -> Result<()> {
        match self.spec {
            Spec::UdpOut(_) => self.start_udp_out(ids, now, address),
            _ => self.start_connecting(now, address),
        }
    }

    /// True if the bridge accepts a station at this address.
    fn allows(&self, address: IpAddr) -> bool {
        let allowed = &self.options.allowed;
        allowed.is_empty() || allowed.contains(&address.to_canonical())
    }

    /// Logs that a station was rejected because there is no room; at most once a minute, because
    /// there may be many.
    fn refuse(&mut self, now: Duration, from: SocketAddr) {
        self.refused += 1;
        if self.refusal_logged_at.is_none_or(|logged_at| now >= logged_at + REJECTION_LOGGED_AFTER)
        {
            self.refusal_logged_at = Some(now);
            self.log.push(format!(
                "{}: no place for {from}; --peer ADDRESS keeps others out",
                self.spec
            ));
        }
    }

    fn peer(&self, name: String, now: Duration) -> Peer {
        Peer {
            name,
            address: None,
            stream: None,
            parser: Parser::new(self.signer.clone()),
            writer: Writer::new(self.options.system, self.options.versions, self.signer.clone()),
            queue: Queue::new(self.options.status_interval),
            unsent: Vec::new(),
            heard: None,
            encoding: if self.options.integers == Integers::Cast {
                IntegerEncoding::Cast
            } else {
                IntegerEncoding::Bytewise
            },
            heard_at: now,
            is_trusted: true,
            sent: 0,
            received: 0,
            radio: None,
        }
    }

    fn add(&mut self, ids: &mut PeerId, peer: Peer) -> PeerId {
        *ids += 1;
        self.peers.insert(*ids, peer);
        *ids
    }

    fn mark_unavailable(&mut self, now: Duration, why: &str) {
        self.transport = Transport::Away(now + RETRY);
        if !self.is_loss_logged {
            self.is_loss_logged = true;
            self.log.push(format!("{} is not available: {why}", self.spec));
        }
    }

    fn mark_available(&mut self) {
        if std::mem::take(&mut self.is_loss_logged) {
            self.log.push(format!("{} is available again", self.spec));
        }
    }

    /// Handles received data, and reopens what was lost.
    pub fn serve(&mut self, now: Duration, bridge: &mut Bridge, ids: &mut PeerId) {
        self.connect(now, bridge, ids);
        self.accept(now, bridge, ids);
        self.receive_datagrams(now, bridge, ids);
        self.receive_streams(now, bridge);
        self.remove_silent(now, bridge);
        for peer in self.peers.values_mut() {
            peer.radio.take_if(|radio| radio.is_gone(now));
        }
        self.close_untrusted(now, bridge);
    }

    /// Puts a message into the queues of its recipients.
    pub fn post(&mut self, now: Duration, post: &Post) {
        match post {
            Post::Message { to: To::One(id), class, out } => {
                if let Some(peer) = self.peers.get_mut(id) {
                    peer.queue.push(*class, out.clone());
                }
            }
            Post::Message { to: To::All, class, out } => {
                self.trusted_peers().for_each(|peer| peer.queue.push(*class, out.clone()));
            }
            Post::Status { node, out } => {
                // A status leaves when the queue of each peer allows it.
                if self.peers.values().any(|peer| peer.queue.has_status(*node)) {
                    self.flush(now);
                }
                self.trusted_peers().for_each(|peer| peer.queue.push_status(*node, out.clone()));
            }
            Post::Forget { node } => {
                self.peers.values_mut().for_each(|peer| peer.queue.forget(*node))
            }
        }
    }

    /// The peers that the bridge sends to.
    fn trusted_peers(&mut self) -> impl Iterator<Item = &mut Peer> {
        self.peers.values_mut().filter(|peer| peer.is_trusted)
    }

    /// Sends what the peers accept, in turns.
    pub fn flush(&mut self, now: Duration) {
        if let Some(budget) = &mut self.budget {
            budget.refill(now);
        }
        let mut sent = true;
        while sent {
            sent = false;
            for peer in self.peers.values_mut() {
                if !write(&self.transport, peer) {
                    continue;
                }
                if self.budget.as_ref().is_some_and(|budget| budget.tokens < 1.0) {
                    return;
                }
                if peer.radio.as_mut().is_some_and(|radio| !radio.has_room(now)) {
                    continue;
                }
                let Some((class, out)) = peer.queue.pop(now) else { continue };
                sent = true;
                if let Some(bytes) = peer.writer.bytes(&out, peer.heard, peer.encoding) {
                    peer.queue.sent(class, bytes.len());
                    if let Some(budget) = &mut self.budget {
                        budget.tokens -= bytes.len() as f64;
                    }
                    if let Some(radio) = &mut peer.radio {
                        radio.spend(bytes.len());
                    }
                    peer.sent += 1;
                    peer.unsent = bytes;
                    write(&self.transport, peer);
                }
            }
        }
    }

    /// When to call again even if nothing is received.
    pub fn deadline(&self) -> Option<Duration> {
        let retry = match &self.transport {
            Transport::Away(until) | Transport::Connecting(_, until) => Some(*until),
            _ => None,
        };
        // `poll` waits until the kernel accepts the rest.
        let waiting = self
            .peers
            .values()
            .filter(|peer| peer.unsent.is_empty())
            .filter_map(|peer| {
                let paced = peer.radio.as_ref().map_or(Duration::ZERO, Radio::next);
                peer.queue.next().map(|at| at.max(paced))
            })
            .min();
        let affordable = self.budget.as_ref().map_or(Duration::ZERO, Budget::next);
        retry.into_iter().chain(waiting.map(|at| at.max(affordable))).min()
    }

    /// The file descriptors to poll; `true` if also for room to write.
    pub fn poll_fds(&self) -> Vec<(BorrowedFd<'_>, bool)> {
        let unsent = self.peers.values().any(|peer| !peer.unsent.is_empty());
        let mut fds = match &self.transport {
            Transport::Udp(socket) => vec![(socket.as_fd(), unsent)],
            Transport::Listener(listener) => vec![(listener.as_fd(), false)],
            Transport::Connecting(socket, _) => vec![(socket.as_fd(), true)],
            Transport::Serial(port) => vec![(port.as_fd(), unsent)],
            Transport::Stream | Transport::LookingUp(_) | Transport::Away(_) => Vec::new(),
        };
        let streams = self
            .peers
            .values()
            .filter_map(|peer| Some((peer.stream.as_ref()?.as_fd(), !peer.unsent.is_empty())));
        fds.extend(streams);
        fds
    }
}

/// Bytes a second on a serial line: a byte takes a start bit, eight data bits and a stop bit. A
/// little less, because clocks differ.
pub fn byte_rate(baud: u32) -> f64 {
    f64::from(baud) / 10.0 * 0.98
}

/// `other` is the channel that reaches a ground station at this address.
fn cannot_listen(local: SocketAddr, other: &str, error: io::Error) -> anyhow::Error {
    match error.kind() {
        ErrorKind::AddrInUse => {
            anyhow!(
                "{local} is in use; does a ground station listen there? Then use {other}:{local}"
            )
        }
        ErrorKind::AddrNotAvailable => {
            anyhow!("{} is not an address of this machine; \"ip address\" lists them", local.ip())
        }
        _ => anyhow!(error).context(format!("cannot listen on {local}")),
    }
}
