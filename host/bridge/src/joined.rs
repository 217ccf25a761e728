//! What is open: the bus, the channels, the pseudo-terminals of the tunnels, and the bridge that
//! joins them. A turn waits for any of them and moves its frames and messages.

use crate::bus::Bus;
use crate::channel::Channel;
use crate::core::Bridge;
use crate::post::PeerId;
use crate::pty::Pty;
use crate::signing::Signing;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Longest turn, so that a pressed key takes effect.
const TURN_MAX: Duration = Duration::from_millis(100);

/// Everything that is open.
pub struct Joined {
    start: Instant,
    /// Set by a signal: the program is to end.
    ended: Arc<AtomicBool>,
    pub bus: Bus,
    pub channels: Vec<Channel>,
    /// The pseudo-terminals of the tunnels.
    pub ptys: Vec<Pty>,
    pub bridge: Bridge,
    signing: Option<Rc<RefCell<Signing>>>,
    /// Number of the next peer.
    pub ids: PeerId,
}

impl Joined {
    /// A bus and a bridge without channels and pseudo-terminals. `ended` ends the program.
    pub fn new(
        ended: Arc<AtomicBool>,
        bus: Bus,
        bridge: Bridge,
        signing: Option<Rc<RefCell<Signing>>>,
    ) -> Joined {
        Joined {
            start: Instant::now(),
            ended,
            bus,
            channels: Vec::new(),
            ptys: Vec::new(),
            bridge,
            signing,
            ids: 0,
        }
    }

    /// Time since the start.
    pub fn now(&self) -> Duration {
        self.start.elapsed()
    }

    /// True if a signal has asked the program to end.
    pub fn is_ended(&self) -> bool {
        self.ended.load(Ordering::Relaxed)
    }

    /// Waits until there is something to do, and does it.
    pub fn turn(&mut self, end: Option<Duration>) {
        self.wait(end);
        let now = self.now();
        let was_up = self.bus.is_up();
        let frames = self.bus.serve(now);
        if self.bus.is_up() && !was_up {
            self.bridge.bus_is_back();
        }
        for frame in frames {
            self.bridge.frame(now, &frame);
            self.deliver(now);
        }
        for channel in &mut self.channels {
            channel.serve(now, &mut self.bridge, &mut self.ids);
        }
        for (at, pty) in self.ptys.iter_mut().enumerate() {
            if self.bus.is_up() && self.bridge.tunnels().has_room(at) {
                let bytes = pty.read();
                self.bridge.tunnels_mut().write(at, pty.baud_rate(), &bytes);
            }
        }
        self.bridge.poll(now);
        self.deliver(now);
        for (at, bytes) in self.bridge.tunnels_mut().take_received() {
            self.ptys[at].write(&bytes);
        }
        self.ptys.iter_mut().for_each(Pty::flush);
        for channel in &mut self.channels {
            channel.flush(now);
        }
    }

    /// Sends the bridge's frames and messages.
    fn deliver(&mut self, now: Duration) {
        for frame in self.bridge.frames.drain(..) {
            self.bus.send(now, frame);
        }
        for post in self.bridge.take_posts() {
            self.channels.iter_mut().for_each(|channel| channel.post(now, &post));
        }
    }

    fn wait(&self, end: Option<Duration>) {
        let now = self.now();
        let channels = self.channels.iter().filter_map(Channel::deadline);
        let deadlines = channels
            .chain(self.bus.deadline())
            .chain(end)
            .chain([self.bridge.deadline(), now + TURN_MAX]);
        let until = deadlines.min().unwrap_or(now);
        // Rounded up, because a poll that returns early finds nothing to do.
        let wait = until.saturating_sub(now) + Duration::from_micros(50);
        let fds = self.channels.iter().flat_map(Channel::poll_fds).chain(self.bus.poll_fd());
        // Bytes that cannot be sent stay in the pseudo-terminal; the loop does not wait for them.
        let takes = |at: usize| self.bus.is_up() && self.bridge.tunnels().has_room(at);
        let ptys = self.ptys.iter().enumerate().filter(|(at, _)| takes(*at));
        let fds = fds.chain(ptys.map(|(_, pty)| pty.poll_fd()));
        let flags = |write| if write { PollFlags::IN | PollFlags::OUT } else { PollFlags::IN };
        let mut fds: Vec<PollFd<'_>> =
            fds.map(|(fd, write)| PollFd::from_borrowed_fd(fd, flags(write))).collect();
        let timeout =
            Timespec { tv_sec: wait.as_secs() as i64, tv_nsec: wait.subsec_nanos().into() };
        // A signal ends the poll. Other errors show when reading.
        let _ = poll(&mut fds, Some(&timeout));
    }

    /// Takes the log lines since the last call.
    pub fn take_log(&mut self) -> Vec<String> {
        let mut lines = std::mem::take(&mut self.bus.log);
        for channel in &mut self.channels {
            lines.append(&mut channel.log);
        }
        lines.append(&mut self.bridge.take_log());
        if let Some(signing) = &self.signing {
            lines.append(&mut signing.borrow_mut().take_log());
        }
        lines
    }
}
