//! The bus, and this program as a node on it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Error, Result, ensure};
use dronecan_host::link::Bus;
use dronecan_host::{Message, NodeId, Transfer};
use node_tools::update::tool::Tool;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use node_tools::update::args::Args;

/// Time in which a bus must answer after it was opened.
const OPENS_WITHIN: Duration = Duration::from_secs(3);
/// The longest wait for frames, so that a signal takes effect.
const TURN: Duration = Duration::from_millis(50);

/// A [`Tool`] on a bus.
pub struct Client {
    bus: Bus,
    pub tool: Tool,
    start: Instant,
    interrupted: Arc<AtomicBool>,
}

impl Client {
    /// Opens the bus.
    ///
    /// # Errors
    /// If the bus cannot be opened; the message says what to do.
    pub fn open(args: &Args, interrupted: Arc<AtomicBool>) -> Result<Client> {
        let mut client = Client {
            bus: Bus::new(args.bus.clone(), args.bitrate, args.mcast_interface),
            tool: Tool::default(),
            start: Instant::now(),
            interrupted,
        };
        client.bus.open(client.now())?;
        while !client.bus.is_up() {
            ensure!(client.now() < OPENS_WITHIN, "{} does not answer", args.bus);
            ensure!(!client.is_interrupted(), "ended by a signal");
            client.receive()?;
        }
        Ok(client)
    }

    /// Time since the start of the program.
    pub fn now(&self) -> Duration {
        self.start.elapsed()
    }

    /// True if a signal asked the program to end.
    pub fn is_interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }

    /// Sends a request.
    pub fn request(&mut self, message: &Message, destination: NodeId) {
        self.tool.request(message, destination);
        self.send();
    }

    /// Answers a request.
    pub fn answer(&mut self, request: &Transfer, payload: &[u8]) {
        self.tool.answer(request, payload);
        self.send();
    }

    fn send(&mut self) {
        let now = self.now();
        for frame in self.tool.take_frames() {
            self.bus.send(now, frame);
        }
    }

    /// Waits for frames, at most [`TURN`]. Returns the completed transfers, without those for other
    /// nodes, but with the requests of file.Read to them.
    ///
    /// # Errors
    /// If the bus was lost.
    pub fn receive(&mut self) -> Result<Vec<Transfer>> {
        let wait = Timespec { tv_sec: 0, tv_nsec: TURN.subsec_nanos().into() };
        if let Some((fd, wants_to_write)) = self.bus.poll_fd() {
            let flags = if wants_to_write { PollFlags::IN | PollFlags::OUT } else { PollFlags::IN };
            // A signal causes an error here; the flag handles it.
            let _ = poll(&mut [PollFd::from_borrowed_fd(fd, flags)], Some(&wait));
        }
        let now = self.now();
        if self.bus.is_up() {
            self.tool.poll(now);
            self.send();
        }
        let frames = self.bus.serve(now);
        let transfers = frames.iter().filter_map(|frame| self.tool.receive(frame, now)).collect();
        match self.bus.trouble() {
            Some(trouble) => Err(Error::msg(format!("the bus is not available: {trouble}"))),
            None => Ok(transfers),
        }
    }

    /// Closes the bus.
    pub fn close(&mut self) {
        self.bus.close();
    }
}
