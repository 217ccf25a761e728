//! MAVLink channels: UDP, TCP or a serial port, and the ground stations at their other ends.
//!
//! A channel has one far end (`udpout`, `tcp`, `serial`) or several (`udpin`, `tcpin`), each a [`Peer`] with its own queue, its own
//! version of MAVLink and its own count of messages. Nothing blocks: what a channel does not take waits in the queue, which gives
//! up the least important. A channel whose rate is known is not filled beyond it, so that what matters does not wait behind
//! what does not.

mod spec;

use crate::core::Bridge;
use crate::message::{Parser, Refused, Request, Versions, Writer};
use crate::number::Custom;
use crate::post::{Asker, PeerId, Post, To};
use crate::queue::{CLASSES, Queue};
use anyhow::{Context, Result, anyhow};
use mavlink::{MavlinkVersion, SigningConfig, SigningData};
use rustix::io::Errno;
use serial2::SerialPort;
use socket2::{Domain, Protocol, SockRef, Socket, Type};
use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream, ToSocketAddrs, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};
use std::rc::Rc;
use std::time::Duration;

pub use spec::Spec;

/// Ground stations at one open port.
const PEERS_MAX: usize = 16;
/// A station on UDP that is silent for that long is gone: they send a heartbeat each second.
const SILENT_FOR: Duration = Duration::from_secs(60);
const RETRY: Duration = Duration::from_secs(1);
const CONNECT_FOR: Duration = Duration::from_secs(5);
/// Reads in one turn, of each peer.
const READS_AT_ONCE: usize = 64;
/// What the kernel may hold back of a TCP connection: enough for speed, and little enough that statuses are not old.
const SEND_BUFFER: usize = 32 * 1024;
/// Longer than any message, for a rate at which that takes its time.
const BURST_MIN: f64 = 300.0;
/// The component by which MAVProxy is known. It takes integers for floats unless component 1 says that it is a PX4.
const MAVPROXY: u8 = 230;

/// How integers are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Integers {
    /// Their bytes; to MAVProxy, which takes them for floats, as floats
    #[default]
    Auto,
    /// Their bytes, as PX4 does
    Bytes,
    /// As floats of the same value, as ArduPilot does
    Cast,
}

/// What is the same for all channels.
#[derive(Clone)]
pub struct Options {
    pub system: u8,
    pub versions: Versions,
    pub integers: Integers,
    /// The least time between two statuses of a node.
    pub status_interval: Duration,
    /// Bytes a second, of channels that are not serial.
    pub byte_rate: Option<f64>,
    pub key: Option<[u8; 32]>,
}

/// The far end of a channel.
struct Peer {
    name: String,
    /// On UDP.
    address: Option<SocketAddr>,
    /// On TCP.
    stream: Option<TcpStream>,
    parser: Parser,
    writer: Writer,
    queue: Queue,
    /// Of a message that was not taken whole.
    unsent: Vec<u8>,
    heard: Option<MavlinkVersion>,
    custom: Custom,
    heard_at: Duration,
    sent: u64,
    received: u64,
}

enum Transport {
    Udp(UdpSocket),
    Listener(TcpListener),
    Connecting(Socket, Duration),
    Stream,
    Serial(SerialPort),
    /// Not there, to be tried again then.
    Away(Duration),
}

/// A leaky bucket.
struct Budget {
    rate: f64,
    burst: f64,
    tokens: f64,
    at: Duration,
}

impl Budget {
    fn new(rate: f64) -> Budget {
        let burst = (rate / 20.0).max(BURST_MIN);
        Budget { rate, burst, tokens: burst, at: Duration::ZERO }
    }

    fn refill(&mut self, now: Duration) {
        self.tokens = (self.tokens + self.rate * now.saturating_sub(self.at).as_secs_f64()).min(self.burst);
        self.at = now;
    }

    /// When there is something to spend again.
    fn next(&self) -> Duration {
        self.at + Duration::from_secs_f64((1.0 - self.tokens).max(0.0) / self.rate)
    }
}

/// A channel, open or not.
pub struct Channel {
    spec: Spec,
    options: Options,
    signing: Option<Rc<SigningData>>,
    transport: Transport,
    peers: BTreeMap<PeerId, Peer>,
    budget: Option<Budget>,
    malformed: u64,
    unsigned: u64,
    /// Given up by queues of peers that have gone.
    dropped: u64,
    away_said: bool,
    pub log: Vec<String>,
}

impl Channel {
    /// Opens the `number`th channel.
    ///
    /// # Errors
    /// With advice, where waiting would not help or `wait` is not given: a port that is taken, an unknown host, no serial port.
    pub fn open(
        spec: Spec,
        number: usize,
        options: Options,
        ids: &mut PeerId,
        now: Duration,
        wait: bool,
    ) -> Result<Channel> {
        let signing = options
            .key
            .map(|key| Rc::new(SigningData::from_config(SigningConfig::new(key, number as u8, true, false))));
        let rate = match &spec {
            // Start bit, eight bits, stop bit; a little less, for clocks differ.
            Spec::Serial { baud, .. } => Some(f64::from(*baud) / 10.0 * 0.98),
            _ => options.byte_rate,
        };
        let mut channel = Channel {
            spec,
            options,
            signing,
            transport: Transport::Away(now),
            peers: BTreeMap::new(),
            budget: rate.map(Budget::new),
            malformed: 0,
            unsigned: 0,
            dropped: 0,
            away_said: false,
            log: Vec::new(),
        };
        match channel.start(ids, now) {
            Err(error) if !wait => Err(error),
            Err(error) => {
                channel.away(now, &format!("{error:#}"));
                Ok(channel)
            }
            Ok(()) => Ok(channel),
        }
    }

    fn start(&mut self, ids: &mut PeerId, now: Duration) -> Result<()> {
        match self.spec.clone() {
            Spec::UdpOut(remote) => {
                let address = resolve(&remote)?;
                let local: IpAddr = match address.ip() {
                    ip if ip.is_loopback() => ip,
                    IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
                    IpAddr::V6(_) => std::net::Ipv6Addr::UNSPECIFIED.into(),
                };
                let socket = UdpSocket::bind((local, 0)).context("cannot make a UDP socket")?;
                socket.set_nonblocking(true)?;
                self.transport = Transport::Udp(socket);
                let peer = self.peer(address.to_string(), now);
                self.add(ids, Peer { address: Some(address), ..peer });
            }
            Spec::UdpIn(local) => {
                let socket = UdpSocket::bind(local).map_err(|error| cannot_listen(local, error))?;
                socket.set_nonblocking(true)?;
                self.transport = Transport::Udp(socket);
            }
            Spec::TcpIn(local) => {
                let listener = TcpListener::bind(local).map_err(|error| cannot_listen(local, error))?;
                listener.set_nonblocking(true)?;
                self.transport = Transport::Listener(listener);
            }
            Spec::TcpOut(remote) => {
                let address = resolve(&remote)?;
                let socket = Socket::new(Domain::for_address(address), Type::STREAM, Some(Protocol::TCP))?;
                socket.set_nonblocking(true)?;
                match socket.connect(&address.into()) {
                    Err(error) if error.raw_os_error() != Some(Errno::INPROGRESS.raw_os_error()) => {
                        self.away(now, &error.to_string());
                    }
                    _ => self.transport = Transport::Connecting(socket, now + CONNECT_FOR),
                }
            }
            Spec::Serial { path, baud } => {
                let port = SerialPort::open(&path, baud).map_err(|error| match error.kind() {
                    ErrorKind::NotFound => anyhow!("there is no {}; is the radio plugged in?", path.display()),
                    _ => anyhow!(error).context(format!("cannot open {}", path.display())),
                })?;
                self.transport = Transport::Serial(port);
                self.came_back();
                let peer = self.peer(path.display().to_string(), now);
                self.add(ids, peer);
            }
        }
        Ok(())
    }

    fn peer(&self, name: String, now: Duration) -> Peer {
        Peer {
            name,
            address: None,
            stream: None,
            parser: Parser::new(self.signing.clone()),
            writer: Writer::new(self.options.system, self.options.versions, self.signing.clone()),
            queue: Queue::new(self.options.status_interval),
            unsent: Vec::new(),
            heard: None,
            custom: if self.options.integers == Integers::Cast { Custom::Cast } else { Custom::Bytewise },
            heard_at: now,
            sent: 0,
            received: 0,
        }
    }

    fn add(&mut self, ids: &mut PeerId, peer: Peer) -> PeerId {
        *ids += 1;
        self.peers.insert(*ids, peer);
        *ids
    }

    fn away(&mut self, now: Duration, why: &str) {
        self.transport = Transport::Away(now + RETRY);
        if !self.away_said {
            self.away_said = true;
            self.log.push(format!("{} is away: {why}", self.spec));
        }
    }

    fn came_back(&mut self) {
        if std::mem::take(&mut self.away_said) {
            self.log.push(format!("{} is back", self.spec));
        }
    }

    /// Takes what has come, to the bridge; gets back what was lost.
    pub fn serve(&mut self, now: Duration, bridge: &mut Bridge, ids: &mut PeerId) {
        self.connect(now, bridge, ids);
        self.accept(now, bridge, ids);
        self.receive_datagrams(now, bridge, ids);
        self.receive_streams(now, bridge);
        self.miss_silent(now, bridge);
    }

    fn connect(&mut self, now: Duration, bridge: &mut Bridge, ids: &mut PeerId) {
        match &self.transport {
            Transport::Away(until) if now >= *until => {
                if let Err(error) = self.start(ids, now) {
                    self.away(now, &format!("{error:#}"));
                }
            }
            Transport::Connecting(socket, until) => {
                let trouble = match socket.take_error() {
                    Ok(Some(error)) | Err(error) => Some(error.to_string()),
                    Ok(None) if now >= *until => Some(String::from("no answer")),
                    Ok(None) => None,
                };
                if let Some(trouble) = trouble {
                    return self.away(now, &trouble);
                }
                if socket.peer_addr().is_ok()
                    && let Transport::Connecting(socket, _) = std::mem::replace(&mut self.transport, Transport::Stream)
                {
                    self.came_back();
                    let name = self.spec.to_string();
                    let id = self.add_stream(ids, now, name, socket.into());
                    bridge.joined(now, id);
                }
            }
            _ => {}
        }
    }

    fn add_stream(&mut self, ids: &mut PeerId, now: Duration, name: String, stream: TcpStream) -> PeerId {
        // All three only make it faster.
        let _ = stream.set_nodelay(true);
        let _ = SockRef::from(&stream).set_send_buffer_size(SEND_BUFFER);
        let _ = SockRef::from(&stream).set_keepalive(true);
        let peer = self.peer(name, now);
        self.add(ids, Peer { stream: Some(stream), ..peer })
    }

    fn accept(&mut self, now: Duration, bridge: &mut Bridge, ids: &mut PeerId) {
        loop {
            let Transport::Listener(listener) = &self.transport else { return };
            let Ok((stream, from)) = listener.accept() else { return };
            if self.peers.len() >= PEERS_MAX || stream.set_nonblocking(true).is_err() {
                self.log.push(format!("{}: {from} is one too many", self.spec));
                continue;
            }
            self.log.push(format!("{}: {from} has connected", self.spec));
            let id = self.add_stream(ids, now, from.to_string(), stream);
            bridge.joined(now, id);
        }
    }

    fn receive_datagrams(&mut self, now: Duration, bridge: &mut Bridge, ids: &mut PeerId) {
        let mut buffer = [0; 2048];
        for _ in 0..READS_AT_ONCE * PEERS_MAX {
            let Transport::Udp(socket) = &self.transport else { return };
            let (length, from) = match socket.recv_from(&mut buffer) {
                Ok(received) => received,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                // Somebody's port was closed, which is no fault of this socket.
                Err(_) => continue,
            };
            let known = self.peers.iter().find(|(_, peer)| peer.address == Some(from)).map(|(id, _)| *id);
            match known {
                Some(id) => self.take_datagram(now, bridge, id, &buffer[..length]),
                // Only the station that was named may answer.
                None if matches!(self.spec, Spec::UdpOut(_)) => self.malformed += 1,
                None => self.meet(now, bridge, ids, from, &buffer[..length]),
            }
        }
    }

    /// Bytes of somebody new: a peer, if there is a message in them.
    fn meet(&mut self, now: Duration, bridge: &mut Bridge, ids: &mut PeerId, from: SocketAddr, bytes: &[u8]) {
        if !has_message(bytes) {
            self.malformed += 1;
            return;
        }
        let peer = Peer { address: Some(from), ..self.peer(from.to_string(), now) };
        if self.peers.len() >= PEERS_MAX {
            let quietest = self.peers.iter().min_by_key(|(_, peer)| peer.heard_at).map(|(id, _)| *id);
            quietest.into_iter().for_each(|id| self.remove(bridge, id, "made room"));
        }
        let id = self.add(ids, peer);
        let before = self.unsigned;
        // Before anything that it asked for is answered.
        bridge.joined(now, id);
        self.take(now, bridge, id, bytes);
        if self.unsigned > before {
            // Whoever has no key hears nothing.
            self.peers.remove(&id);
            return;
        }
        self.log.push(format!("{}: {from} is there", self.spec));
    }

    fn receive_streams(&mut self, now: Duration, bridge: &mut Bridge) {
        let ids: Vec<PeerId> = self.peers.keys().copied().collect();
        let mut buffer = [0; 2048];
        for id in ids {
            for _ in 0..READS_AT_ONCE {
                let read = match (&self.transport, self.peers.get_mut(&id).and_then(|peer| peer.stream.as_mut())) {
                    (Transport::Serial(port), _) => rustix::io::read(port, &mut buffer).map_err(io::Error::from),
                    (_, Some(stream)) => stream.read(&mut buffer),
                    _ => break,
                };
                match read {
                    Ok(0) => {
                        self.lose(now, bridge, id, "closed");
                        break;
                    }
                    Ok(length) => self.take(now, bridge, id, &buffer[..length]),
                    Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                    Err(error) if error.kind() == ErrorKind::Interrupted => {}
                    Err(error) => {
                        self.lose(now, bridge, id, &error.to_string());
                        break;
                    }
                }
            }
        }
    }

    /// A stream has ended.
    fn lose(&mut self, now: Duration, bridge: &mut Bridge, id: PeerId, why: &str) {
        self.remove(bridge, id, why);
        if matches!(self.transport, Transport::Stream | Transport::Serial(_)) {
            self.away_said = true;
            self.transport = Transport::Away(now + RETRY);
        }
    }

    fn remove(&mut self, bridge: &mut Bridge, id: PeerId, why: &str) {
        if let Some(peer) = self.peers.remove(&id) {
            self.dropped += peer.queue.dropped().values().sum::<u64>();
            self.log.push(format!("{}: {} is gone: {why}", self.spec, peer.name));
            bridge.left(id);
        }
    }

    /// A message is in one datagram, with rare exceptions. So what was left of one that was rubbish is not waited for.
    fn take_datagram(&mut self, now: Duration, bridge: &mut Bridge, id: PeerId, bytes: &[u8]) {
        if let Some(peer) = self.peers.get_mut(&id).filter(|_| has_message(bytes)) {
            peer.parser = Parser::new(self.signing.clone());
        }
        self.take(now, bridge, id, bytes);
    }

    fn take(&mut self, now: Duration, bridge: &mut Bridge, id: PeerId, bytes: &[u8]) {
        let Some(peer) = self.peers.get_mut(&id) else { return };
        peer.parser.feed(bytes);
        while let Some(message) = peer.parser.message() {
            match message {
                Ok((version, message)) => {
                    peer.heard = Some(version);
                    peer.heard_at = now;
                    peer.received += 1;
                    let of_parameters = matches!(
                        message.request,
                        Request::ParameterList | Request::ParameterRead { .. } | Request::ParameterSet { .. }
                    );
                    if self.options.integers == Integers::Auto && of_parameters {
                        peer.custom = if message.from.1 == MAVPROXY { Custom::Cast } else { Custom::Bytewise };
                    }
                    bridge.message(now, Asker { peer: id, from: message.from, custom: peer.custom }, message);
                }
                Err(Refused::Malformed) => self.malformed += 1,
                Err(Refused::Signature) => self.unsigned += 1,
            }
        }
    }

    fn miss_silent(&mut self, now: Duration, bridge: &mut Bridge) {
        if !matches!(self.spec, Spec::UdpIn(_)) {
            return;
        }
        let silent = |peer: &Peer| now > peer.heard_at + SILENT_FOR;
        let gone: Vec<PeerId> = self.peers.iter().filter(|(_, peer)| silent(peer)).map(|(id, _)| *id).collect();
        for id in gone {
            self.remove(bridge, id, "silent");
        }
    }

    /// Puts something into the queues of those it is for.
    pub fn post(&mut self, now: Duration, post: &Post) {
        match post {
            Post::Message { to: To::One(id), class, out } => {
                if let Some(peer) = self.peers.get_mut(id) {
                    peer.queue.push(*class, out.clone());
                }
            }
            Post::Message { to: To::All, class, out } => {
                self.peers.values_mut().for_each(|peer| peer.queue.push(*class, out.clone()));
            }
            Post::Status { node, out } => {
                // Each status leaves where there is room for it.
                if self.peers.values().any(|peer| peer.queue.has_status(*node)) {
                    self.flush(now);
                }
                self.peers.values_mut().for_each(|peer| peer.queue.push_status(*node, out.clone()));
            }
            Post::Forget { node } => self.peers.values_mut().for_each(|peer| peer.queue.forget(*node)),
        }
    }

    /// Sends what there is room for. The peers take turns.
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
                let Some(out) = peer.queue.pop(now) else { continue };
                sent = true;
                if let Some(bytes) = peer.writer.bytes(&out, peer.heard, peer.custom) {
                    if let Some(budget) = &mut self.budget {
                        budget.tokens -= bytes.len() as f64;
                    }
                    peer.sent += 1;
                    peer.unsent = bytes;
                    write(&self.transport, peer);
                }
            }
        }
    }

    /// When to look at it again even if nothing comes.
    pub fn deadline(&self) -> Option<Duration> {
        let retry = match &self.transport {
            Transport::Away(until) | Transport::Connecting(_, until) => Some(*until),
            _ => None,
        };
        // What the kernel does not take is waited for by poll.
        let waiting =
            self.peers.values().filter(|peer| peer.unsent.is_empty()).filter_map(|peer| peer.queue.next()).min();
        let affordable = self.budget.as_ref().map_or(Duration::ZERO, Budget::next);
        retry.into_iter().chain(waiting.map(|at| at.max(affordable))).min()
    }

    /// What to wait for, and whether for room to write too.
    pub fn poll_fds(&self) -> Vec<(BorrowedFd<'_>, bool)> {
        let unsent = self.peers.values().any(|peer| !peer.unsent.is_empty());
        let mut fds = match &self.transport {
            Transport::Udp(socket) => vec![(socket.as_fd(), unsent)],
            Transport::Listener(listener) => vec![(listener.as_fd(), false)],
            Transport::Connecting(socket, _) => vec![(socket.as_fd(), true)],
            Transport::Serial(port) => vec![(port.as_fd(), unsent)],
            Transport::Stream | Transport::Away(_) => Vec::new(),
        };
        let streams =
            self.peers.values().filter_map(|peer| Some((peer.stream.as_ref()?.as_fd(), !peer.unsent.is_empty())));
        fds.extend(streams);
        fds
    }

    /// Lines for people: the channel, and its peers.
    pub fn report(&self) -> Vec<String> {
        let mut first = self.spec.to_string();
        if matches!(self.transport, Transport::Away(_) | Transport::Connecting(..)) {
            first += ", away";
        }
        let dropped = self.dropped;
        let troubles = [(self.malformed, "malformed"), (self.unsigned, "not signed"), (dropped, "dropped before")];
        for (count, what) in troubles.into_iter().filter(|(count, _)| *count > 0) {
            first += &format!(", {count} {what}");
        }
        let mut lines = vec![first];
        for peer in self.peers.values() {
            let mut line = format!("  {}: {} in, {} out", peer.name, peer.received, peer.sent);
            for (class, what) in CLASSES {
                if let Some(count) = peer.queue.dropped().get(&class) {
                    line += &format!(", {count} {what}{}", if what.ends_with("out") { "" } else { " dropped" });
                }
            }
            lines.push(line);
        }
        lines
    }
}

/// Whether a message begins and ends in these bytes. Signatures are left to who reads them: no message may be checked twice.
fn has_message(bytes: &[u8]) -> bool {
    let mut parser = Parser::new(None);
    parser.feed(bytes);
    matches!(parser.message(), Some(Ok(_)))
}

/// Writes what is left of a message; whether it is all gone. Errors show when reading.
fn write(transport: &Transport, peer: &mut Peer) -> bool {
    while !peer.unsent.is_empty() {
        let written = match (transport, peer.stream.as_mut(), peer.address) {
            (Transport::Udp(socket), _, Some(address)) => {
                match socket.send_to(&peer.unsent, address) {
                    Err(error) if error.kind() == ErrorKind::WouldBlock => Err(error),
                    // No route, or nobody there: as lost as on a radio.
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

fn resolve(remote: &str) -> Result<SocketAddr> {
    let found = remote.to_socket_addrs().with_context(|| format!("there is no host for {remote}"))?;
    let all: Vec<SocketAddr> = found.collect();
    // Ground stations listen on IPv4.
    all.iter()
        .find(|address| address.is_ipv4())
        .or(all.first())
        .copied()
        .with_context(|| format!("no address for {remote}"))
}

fn cannot_listen(local: SocketAddr, error: io::Error) -> anyhow::Error {
    match error.kind() {
        ErrorKind::AddrInUse => {
            anyhow!("{local} is in use; does a ground station listen there? Then send to it with udpout:{local}")
        }
        ErrorKind::AddrNotAvailable => {
            anyhow!("{} is no address of this machine; \"ip address\" lists them", local.ip())
        }
        _ => anyhow!(error).context(format!("cannot listen on {local}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_is_kept_over_time() {
        let mut budget = Budget::new(5760.0);
        let mut spent = 0.0;
        for ms in 0..10_000 {
            budget.refill(Duration::from_millis(ms));
            while budget.tokens >= 1.0 {
                budget.tokens -= 29.0;
                spent += 29.0;
            }
        }
        assert!((57_000.0..58_500.0).contains(&spent), "{spent}");
    }
}
