//! A CAN bus for programs on a host: an SLCAN adapter, the multicast bus of DroneCAN, or SocketCAN.
//! A lost bus is reopened.
//!
//! Nothing here blocks. Frames that the bus does not accept are queued. Beyond `QUEUE_LIMIT` the
//! newest are dropped and counted, as with a full transmit queue: a requester repeats what is not
//! answered.

use crate::mcast;
use crate::slcan::adapter::{Adapter, Channel, Refusal};
use crate::{Frame, Id};
use anyhow::{Context, Result, anyhow, bail};
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use serial2::SerialPort;
use socketcan::{CanSocket, EmbeddedFrame as _, Socket as _};
use std::collections::VecDeque;
use std::fmt;
use std::io::{self, ErrorKind};
use std::net::Ipv4Addr;
use std::os::fd::{AsFd, BorrowedFd};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

/// Maximum number of queued frames: half a second of a bus with a few requests.
const QUEUE_LIMIT: usize = 1000;
/// Maximum number of frames received in one turn, so that a busy bus does not stop the program's
/// other work.
const TAKEN_AT_ONCE: usize = 500;
/// Time between attempts to reopen the bus.
const RETRY: Duration = Duration::from_secs(1);
/// Baud rate of the adapter's serial port. USB adapters and pseudo-terminals ignore it.
const SLCAN_BAUD: u32 = 115_200;

/// A bus as the user writes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Spec {
    Slcan { path: PathBuf, baud: u32 },
    Mcast(u8),
    SocketCan(String),
}

impl FromStr for Spec {
    type Err = String;

    fn from_str(text: &str) -> Result<Spec, String> {
        let (kind, rest) = text.split_once(':').unwrap_or((text, ""));
        match (kind, rest) {
            (_, "") => {
                Err(String::from("write for example slcan:/dev/ttyACM0, mcast:0 or socketcan:can0"))
            }
            ("slcan", path) => {
                let (path, baud) = match path.rsplit_once(':') {
                    Some((path, baud)) => {
                        (path, baud.parse().map_err(|_| format!("\"{baud}\" is not a baud rate"))?)
                    }
                    None => (path, SLCAN_BAUD),
                };
                Ok(Spec::Slcan { path: path.into(), baud })
            }
            ("mcast", bus) => bus
                .parse()
                .map(Spec::Mcast)
                .map_err(|_| format!("\"{bus}\" is not a bus: 0 to 255, mostly 0")),
            ("socketcan", interface) => Ok(Spec::SocketCan(interface.to_owned())),
            (other, _) => {
                Err(format!("unknown kind of bus \"{other}\": slcan, mcast or socketcan"))
            }
        }
    }
}

impl fmt::Display for Spec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Spec::Slcan { path, .. } => write!(f, "slcan:{}", path.display()),
            Spec::Mcast(bus) => write!(f, "mcast:{bus}"),
            Spec::SocketCan(interface) => write!(f, "socketcan:{interface}"),
        }
    }
}

/// Numbers of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    pub received: u64,
    pub sent: u64,
    /// Frames for which the queue had no room, or that were queued when the bus was lost.
    pub dropped: u64,
    /// Frames that came back from the adapter that had sent them.
    pub echoed: u64,
    /// Lines of the adapter that are not SLCAN.
    pub invalid: u64,
}

/// A bus that is open, or that is to be reopened.
pub struct Bus {
    spec: Spec,
    bit_rate: u32,
    interface: Option<Ipv4Addr>,
    line: Option<Line>,
    retry_at: Duration,
    queue: VecDeque<Frame>,
    wants_stamps: bool,
    /// The time stamps in microseconds of the frames that [`Bus::serve`] returned last, from an
    /// SLCAN adapter that adds them.
    pub stamps: Vec<Option<u64>>,
    pub counters: Counters,
    /// Why the bus is not open, as it was last logged.
    trouble: Option<String>,
    pub log: Vec<String>,
}

enum Line {
    Slcan(Slcan),
    Mcast(mcast::Port),
    SocketCan(CanSocket),
}

impl Bus {
    /// A bus that is not opened yet.
    pub fn new(spec: Spec, bit_rate: u32, interface: Option<Ipv4Addr>) -> Bus {
        Bus {
            spec,
            bit_rate,
            interface,
            line: None,
            retry_at: Duration::ZERO,
            queue: VecDeque::new(),
            wants_stamps: false,
            stamps: Vec::new(),
            counters: Counters::default(),
            trouble: None,
            log: Vec::new(),
        }
    }

    /// Requests time stamps from an SLCAN adapter, from its next opening on.
    pub fn request_stamps(&mut self) {
        self.wants_stamps = true;
    }

    /// The adapter of the bus, if it is SLCAN.
    pub fn adapter(&mut self) -> Option<&mut Adapter> {
        match &mut self.line {
            Some(Line::Slcan(slcan)) => Some(&mut slcan.adapter),
            _ => None,
        }
    }

    /// Opens the bus.
    ///
    /// # Errors
    /// If it cannot be opened. The error has a remedy.
    pub fn open(&mut self, now: Duration) -> Result<()> {
        let line = match &self.spec {
            Spec::Slcan { path, baud } => {
                let question = "is the adapter plugged in, or sim running?";
                let port = open_serial(path, *baud, "adapter", question)?;
                // Two programs would take each other's bytes, and close each other's channel.
                if flock(&port, FlockOperation::NonBlockingLockExclusive).is_err() {
                    bail!("another program uses {}: an update, or a bridge?", path.display());
                }
                Line::Slcan(Slcan::new(port, self.bit_rate, self.wants_stamps, now)?)
            }
            Spec::Mcast(bus) => Line::Mcast(mcast::Port::open(*bus, self.interface)?),
            Spec::SocketCan(name) => {
                let open = || {
                    let socket = CanSocket::open(name)?;
                    socket.set_nonblocking(true)?;
                    Ok(socket)
                };
                let socket: io::Result<CanSocket> = open();
                Line::SocketCan(socket.map_err(|error| match error.raw_os_error() {
                    Some(errno) if errno == Errno::AFNOSUPPORT.raw_os_error() => {
                        anyhow!("this kernel has no SocketCAN; use slcan: or mcast:")
                    }
                    _ => anyhow!(error).context(format!(
                        "cannot open the CAN interface {name}; \"ip link\" lists them"
                    )),
                })?)
            }
        };
        self.line = Some(line);
        Ok(())
    }

    /// True if the bus is open.
    pub fn is_up(&self) -> bool {
        match &self.line {
            Some(Line::Slcan(slcan)) => slcan.adapter.is_open(),
            Some(_) => true,
            None => false,
        }
    }

    /// Returns the received frames, and reopens a bus that was lost.
    pub fn serve(&mut self, now: Duration) -> Vec<Frame> {
        if self.line.is_none() && now >= self.retry_at {
            self.retry_at = now + RETRY;
            if let Err(error) = self.open(now) {
                self.log_trouble(format!("{error:#}"));
            }
        }
        let was_up = self.is_up();
        let mut frames = Vec::new();
        self.stamps.clear();
        if let Err(error) = self.receive(now, &mut frames) {
            self.lost(now, &error);
        }
        if self.is_up() && !was_up && self.trouble.take().is_some() {
            self.log.push(format!("bus {} is available again", self.spec));
        }
        self.counters.received += frames.len() as u64;
        self.transmit(now);
        frames
    }

    fn receive(&mut self, now: Duration, frames: &mut Vec<Frame>) -> Result<()> {
        match &mut self.line {
            Some(Line::Slcan(slcan)) => {
                let served = slcan.serve(now, frames, &mut self.stamps);
                let invalid = std::mem::take(&mut slcan.adapter.invalid);
                let echoed = std::mem::take(&mut slcan.adapter.echoed);
                if echoed > 0 && self.counters.echoed == 0 {
                    self.log.push(format!(
                        "{} returns the frames that it has sent: they are ignored. Or does another \
                         program have the same node ID?",
                        self.spec
                    ));
                }
                if invalid > 0 && self.counters.invalid == 0 {
                    self.log.push(format!(
                        "{} sends lines that are not SLCAN: is its baud rate right? \
                         (slcan:PATH:BAUD)",
                        self.spec
                    ));
                }
                self.counters.invalid += invalid;
                self.counters.echoed += echoed;
                return served;
            }
            Some(Line::Mcast(port)) => {
                for _ in 0..TAKEN_AT_ONCE {
                    match port.receive() {
                        Ok(Some(Ok(frame))) => frames.push(frame),
                        // Our own datagram, or not a classic frame.
                        Ok(_) => {}
                        Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                        Err(error) => return Err(error.into()),
                    }
                }
            }
            Some(Line::SocketCan(socket)) => {
                for _ in 0..TAKEN_AT_ONCE {
                    match socket.read_frame() {
                        Ok(socketcan::CanFrame::Data(frame)) => {
                            let id = match frame.id() {
                                socketcan::Id::Standard(id) => Id::Standard(id.as_raw()),
                                socketcan::Id::Extended(id) => Id::Extended(id.as_raw()),
                            };
                            let mut data = [0; 8];
                            data[..frame.data().len()].copy_from_slice(frame.data());
                            frames.push(Frame::with_dlc(id, frame.data().len() as u8, data));
                        }
                        Ok(_) => {}
                        Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                        Err(error) => return Err(error.into()),
                    }
                }
            }
            None => {}
        }
        Ok(())
    }

    /// Sends a frame, or queues it until the bus accepts it. If the bus is lost, the frame is
    /// dropped.
    pub fn send(&mut self, now: Duration, frame: Frame) {
        if !self.is_up() {
            return;
        }
        if self.queue.len() >= QUEUE_LIMIT {
            self.counters.dropped += 1;
            return;
        }
        self.queue.push_back(frame);
        self.transmit(now);
    }

    /// The number of frames that wait for the bus.
    pub fn waiting(&self) -> usize {
        self.queue.len()
    }

    fn transmit(&mut self, now: Duration) {
        while let Some(frame) = self.queue.front() {
            let sent = match &mut self.line {
                Some(Line::Slcan(slcan)) if slcan.adapter.is_open() => slcan.send(frame, now),
                Some(Line::Mcast(port)) => port.send(frame).map(|_| true),
                Some(Line::SocketCan(socket)) => send_socketcan(socket, frame),
                _ => return,
            };
            match sent {
                Ok(true) => {
                    self.counters.sent += 1;
                    self.queue.pop_front();
                }
                Ok(false) => return,
                Err(error) => {
                    self.lost(now, &error.into());
                }
            }
        }
    }

    fn lost(&mut self, now: Duration, error: &anyhow::Error) {
        self.line = None;
        self.counters.dropped += self.queue.len() as u64;
        self.queue.clear();
        self.retry_at = now + RETRY;
        self.log_trouble(format!("{error:#}"));
    }

    /// Logs why the bus is lost; the same reason only once.
    fn log_trouble(&mut self, why: String) {
        if self.trouble.is_none() {
            self.log.push(format!("bus {} is not available: {why}", self.spec));
        }
        self.trouble = Some(why);
    }

    /// Why the bus is not open; `None` if it is.
    pub fn trouble(&self) -> Option<&str> {
        self.trouble.as_deref()
    }

    /// The file descriptor to poll; `true` if also for room to write.
    pub fn poll_fd(&self) -> Option<(BorrowedFd<'_>, bool)> {
        match self.line.as_ref()? {
            Line::Slcan(slcan) => Some((slcan.port.as_fd(), !slcan.adapter.output().is_empty())),
            Line::Mcast(port) => Some((port.as_fd(), false)),
            Line::SocketCan(socket) => Some((socket.as_fd(), !self.queue.is_empty())),
        }
    }

    /// When to call [`Bus::serve`] again even if nothing is received.
    pub fn deadline(&self) -> Option<Duration> {
        match &self.line {
            None => Some(self.retry_at),
            Some(Line::Slcan(slcan)) => slcan.adapter.deadline(),
            Some(_) => None,
        }
    }

    /// Closes the bus and the adapter's channel.
    pub fn close(&mut self) {
        if let Some(Line::Slcan(slcan)) = &mut self.line {
            let end: &[u8] = if self.wants_stamps { b"C\rZ0\r" } else { b"C\r" };
            let _ = rustix::io::write(&slcan.port, end);
        }
        self.line = None;
    }
}

impl fmt::Display for Bus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Counters { received, sent, dropped, echoed, invalid } = self.counters;
        write!(f, "bus {}: {received} frames in, {sent} out", self.spec)?;
        let rest = [(dropped, "dropped"), (echoed, "returned"), (invalid, "lines not read")];
        for (count, what) in rest.into_iter().filter(|(count, _)| *count > 0) {
            write!(f, ", {count} {what}")?;
        }
        self.trouble.as_ref().map_or(Ok(()), |why| write!(f, ", not available: {why}"))
    }
}

/// Returns `false` if there is no room now.
fn send_socketcan(socket: &CanSocket, frame: &Frame) -> io::Result<bool> {
    let id: Option<socketcan::Id> = match frame.id {
        Id::Standard(id) => socketcan::StandardId::new(id).map(Into::into),
        Id::Extended(id) => socketcan::ExtendedId::new(id).map(Into::into),
    };
    let Some(frame) = id.and_then(|id| socketcan::CanDataFrame::new(id, frame.data())) else {
        return Ok(true);
    };
    match socket.write_frame(&frame) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(false),
        Err(error) if error.raw_os_error() == Some(Errno::NOBUFS.raw_os_error()) => Ok(false),
        Err(error) => Err(error),
    }
}

/// Opens a serial port for a device. `question` says where to look if the port is not there.
///
/// # Errors
/// If it cannot be opened. The error has a remedy.
pub fn open_serial(path: &Path, baud: u32, device: &str, question: &str) -> Result<SerialPort> {
    let shown = path.display();
    SerialPort::open(path, baud).map_err(|error| match error.kind() {
        ErrorKind::NotFound => anyhow!("there is no {shown}; {question}"),
        _ if error.raw_os_error() == Some(Errno::NOTTY.raw_os_error()) => anyhow!(
            "{shown} is not a serial port; those of {device}s are /dev/ttyACM0, /dev/ttyUSB0, .."
        ),
        ErrorKind::PermissionDenied => {
            anyhow!("no permission for {shown}; members of the group dialout have it")
        }
        _ => anyhow!(error).context(format!("cannot open {shown}")),
    })
}

/// An SLCAN adapter on its serial port.
struct Slcan {
    port: SerialPort,
    adapter: Adapter,
}

impl Slcan {
    fn new(port: SerialPort, bit_rate: u32, wants_stamps: bool, now: Duration) -> Result<Slcan> {
        let _ = port.discard_buffers();
        let mut adapter = Adapter::new(bit_rate, Channel::Normal, now);
        if wants_stamps {
            adapter.request_stamps();
        }
        let mut slcan = Slcan { port, adapter };
        slcan.write()?;
        Ok(slcan)
    }

    /// Writes the waiting bytes. Returns true if none is left.
    fn write(&mut self) -> io::Result<bool> {
        while !self.adapter.output().is_empty() {
            match rustix::io::write(&self.port, self.adapter.output()) {
                Ok(written) => self.adapter.written(written),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => return Ok(false),
                Err(error) => return Err(error.into()),
            }
        }
        Ok(true)
    }

    /// Returns `false` if there is no room now.
    fn send(&mut self, frame: &Frame, now: Duration) -> io::Result<bool> {
        if !self.write()? || !self.adapter.send(frame, now) {
            return Ok(false);
        }
        self.write()?;
        Ok(true)
    }

    fn serve(
        &mut self,
        now: Duration,
        frames: &mut Vec<Frame>,
        stamps: &mut Vec<Option<u64>>,
    ) -> Result<()> {
        self.write()?;
        let mut buffer = [0; 4096];
        while frames.len() < TAKEN_AT_ONCE {
            match rustix::io::read(&self.port, &mut buffer) {
                Ok(0) => bail!("the adapter has been unplugged, or another program has opened it"),
                Ok(read) => {
                    // The adapter keeps the stamp of the last frame only.
                    for byte in &buffer[..read] {
                        self.adapter.receive(&[*byte], now, frames).map_err(with_option)?;
                        stamps.resize(frames.len(), self.adapter.stamp_us());
                    }
                    self.write()?;
                }
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => break,
                Err(error) => return Err(io::Error::from(error)).context("the adapter is lost"),
            }
        }
        self.adapter.poll(now).map_err(with_option)?;
        self.write()?;
        Ok(())
    }
}

/// Names the option with which the user chooses another bit rate.
fn with_option(refusal: Refusal) -> anyhow::Error {
    match refusal {
        Refusal::Rejected(_) => anyhow!("{refusal} (--bitrate)"),
        _ => refusal.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specs_have_the_syntax_of_the_help() {
        let slcan = |path: &str, baud| Ok(Spec::Slcan { path: path.into(), baud });
        assert_eq!("slcan:/dev/ttyACM0".parse(), slcan("/dev/ttyACM0", 115_200));
        assert_eq!("slcan:/dev/ttyUSB0:921600".parse(), slcan("/dev/ttyUSB0", 921_600));
        assert_eq!("mcast:1".parse(), Ok(Spec::Mcast(1)));
        assert_eq!("socketcan:can0".parse(), Ok(Spec::SocketCan("can0".into())));
        for wrong in ["", "slcan", "slcan:", "mcast:x", "mcast:256", "can0", "slcan:/dev/x:y"] {
            assert!(wrong.parse::<Spec>().is_err(), "{wrong}");
        }
    }
}
