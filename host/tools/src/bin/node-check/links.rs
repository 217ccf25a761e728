//! The adapter, the serial port and the log of the bus.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::os::fd::AsFd as _;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context as _, Error, Result, bail, ensure};
use dronecan_host::Frame;
use dronecan_host::link::Bus;
use dronecan_host::slcan::adapter::BUS_ERROR;
use node_tools::check::args::Args;
use node_tools::check::session::Session;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use serial2::SerialPort;

/// Time in which an adapter must answer after it was opened.
const OPENS_WITHIN: Duration = Duration::from_secs(3);
/// The longest wait for frames.
const TURN: Timespec = Timespec { tv_sec: 0, tv_nsec: 5_000_000 };
/// Baud rate of the serial monitor.
const BAUD: u32 = 115_200;

/// The adapter, the serial port and the log of the bus.
pub struct Links {
    args: Args,
    bus: Bus,
    /// True while the adapter has another bit rate, which it may reject.
    has_other_rate: bool,
    port: Option<SerialPort>,
    start: Instant,
    /// Time of the start since 1970.
    epoch: Duration,
    log: BufWriter<File>,
}

impl Links {
    /// Opens the bus, and creates its log.
    ///
    /// # Errors
    /// If the bus cannot be opened; the message says what to do.
    pub fn open(args: &Args) -> Result<Links> {
        let path = args.report.join("bus.log");
        let log =
            File::create(&path).with_context(|| format!("cannot write {}", path.display()))?;
        if let Some(port) = &args.port {
            ensure!(port.exists(), "there is no {}: is the Arduino plugged in?", port.display());
        }
        let mut links = Links {
            args: args.clone(),
            bus: Bus::new(args.bus.clone(), args.bitrate, None),
            has_other_rate: false,
            port: None,
            start: Instant::now(),
            epoch: SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default(),
            log: BufWriter::new(log),
        };
        links.bus.request_stamps();
        links.bus.open(links.now())?;
        while !links.bus.is_up() {
            ensure!(links.now() < OPENS_WITHIN, "{} does not answer", args.bus);
            links.wait(false);
            links.bus.serve(links.now());
            if let Some(trouble) = links.bus.trouble() {
                bail!("the adapter {}: {trouble}", args.bus);
            }
        }
        Ok(links)
    }

    /// Time since the start of the program.
    pub fn now(&self) -> Duration {
        self.start.elapsed()
    }

    /// Frames that the adapter has not taken yet.
    pub fn waiting(&self) -> usize {
        self.bus.waiting()
    }

    /// Asks the adapter whether it has seen errors. The answer comes with a later turn.
    pub fn ask_flags(&mut self) {
        if let Some(adapter) = self.bus.adapter() {
            adapter.ask_flags();
        }
    }

    /// Reopens the adapter with a bit rate.
    pub fn set_bit_rate(&mut self, bit_rate: u32) {
        self.has_other_rate = bit_rate != self.args.bitrate;
        self.bus.close();
        self.bus = Bus::new(self.args.bus.clone(), bit_rate, None);
        self.bus.request_stamps();
    }

    fn wait(&self, with_keys: bool) {
        let stdin = std::io::stdin();
        let mut fds = Vec::new();
        if let Some((fd, wants_to_write)) = self.bus.poll_fd() {
            let flags = if wants_to_write { PollFlags::IN | PollFlags::OUT } else { PollFlags::IN };
            fds.push(PollFd::from_borrowed_fd(fd, flags));
        }
        if let Some(port) = &self.port {
            fds.push(PollFd::from_borrowed_fd(port.as_fd(), PollFlags::IN));
        }
        if with_keys {
            fds.push(PollFd::new(&stdin, PollFlags::IN));
        }
        // A signal causes an error here; its flag handles it.
        let _ = poll(&mut fds, Some(&TURN));
    }

    /// Waits for frames and bytes, and hands them to the session.
    ///
    /// # Errors
    /// If the adapter or the port is lost. The adapter is reopened when it is back.
    pub fn turn(&mut self, session: &mut Session, with_keys: bool) -> Result<()> {
        self.wait(with_keys);
        let now = self.now();
        let frames = self.bus.serve(now);
        for (n, frame) in frames.iter().enumerate() {
            self.record(frame)?;
            session.frame(frame, now, self.bus.stamps.get(n).copied().flatten());
        }
        if let Some(flags) = self.bus.adapter().and_then(|adapter| adapter.flags.take()) {
            session.adapter_errors(flags & BUS_ERROR != 0);
        }
        let bytes = self.read_port();
        if let Ok(bytes) = &bytes {
            session.serial(bytes, self.now());
        }
        if let Some(trouble) = self.bus.trouble().filter(|_| !self.has_other_rate) {
            bail!("the adapter {} is lost: {trouble}", self.args.bus);
        }
        bytes.map(drop)
    }

    fn read_port(&mut self) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut buffer = [0; 4096];
        while let Some(port) = &self.port {
            match rustix::io::read(port, &mut buffer) {
                Ok(0) => return Err(self.port_lost(None)),
                Ok(read) => bytes.extend(&buffer[..read]),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => break,
                Err(error) => return Err(self.port_lost(Some(error))),
            }
        }
        Ok(bytes)
    }

    fn port_lost(&mut self, error: Option<Errno>) -> Error {
        self.port = None;
        let why = error.map(|error| format!(": {error}")).unwrap_or_default();
        Error::msg(format!("the serial port is lost{why}: has it been unplugged?"))
    }

    /// Opens the serial port, which resets the board.
    ///
    /// # Errors
    /// If it cannot be opened; the message says what to do.
    pub fn open_port(&mut self) -> Result<()> {
        let Some(path) = &self.args.port else { return Ok(()) };
        let port = SerialPort::open(path, BAUD).with_context(|| {
            format!("cannot open {}; does another program use it?", path.display())
        })?;
        self.port = Some(port);
        Ok(())
    }

    /// Closes the serial port.
    pub fn close_port(&mut self) {
        self.port = None;
    }

    /// Sends bytes to the board.
    pub fn write_port(&mut self, bytes: &[u8]) {
        if let Some(port) = &self.port {
            // A few bytes always fit. A port that is lost is noticed when it is read.
            let _ = rustix::io::write(port, bytes);
        }
    }

    /// Sends the frames of the session.
    pub fn send(&mut self, session: &mut Session) {
        for frame in session.take_frames() {
            // The log of a full disk is not worth the restart of a node in an unknown state.
            let _ = self.record(&frame);
            self.bus.send(self.now(), frame);
        }
    }

    /// Adds a frame to the log, as candump does.
    fn record(&mut self, frame: &Frame) -> Result<()> {
        let at = self.epoch + self.now();
        writeln!(self.log, "({}.{:06}) can0 {frame}", at.as_secs(), at.subsec_micros())
            .context("cannot write bus.log")
    }

    /// Closes the bus, and completes its log.
    pub fn close(&mut self) {
        self.bus.close();
        let _ = self.log.flush();
    }
}
