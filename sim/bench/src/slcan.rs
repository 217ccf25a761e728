//! An SLCAN adapter: `sim` has it on a pseudo-terminal, for pydronecan, the DroneCAN GUI Tool and
//! python-can, and the web page in itself.
//!
//! Each adapter is a station on the bus while its channel is open: it arbitrates and acknowledges
//! like any node. While the channel is closed it takes no part. [`crate::dronecan::slcan`] has the
//! protocol.
//!
//! The adapter loses no frame while its client reads and the bus works. If a client writes faster
//! than the bus carries, its port blocks it. The adapter drops only frames for a client
//! that does not read, the oldest first, and frames for a bus that has taken none for a second. It
//! counts them and shows them in the flags.
//!
//! Limits: an adapter cannot detect that its client has ended, so its channel stays open, as a real
//! adapter's does. An adapter has one client: two clients would steal each other's bytes. Frames
//! that a client sent just before `C` still go out, for a tenth of a second; some real adapters
//! lose them.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use crate::can::{Engine, ErrorState, Event, Frame, Level, SoftNode, Station};
use crate::dronecan::slcan::{self, Command, Lines};
use crate::{Bench, Cycles, F_CPU_HZ};

const OK: &[u8] = b"\r";
const ERROR: &[u8] = b"\x07";
/// Hardware 10, software 13: the versions of the adapter that defined this protocol.
const VERSION: &[u8] = b"V1013\r";
const SERIAL_NUMBER: &[u8] = b"NA123\r";

/// Most frames in the queue for the bus. A full bus carries about 20 of the shortest frames between
/// two calls of `serve`.
const TO_BUS_MAX: usize = 128;
/// Most lines in the queue for the client: half a second of a full bus.
const TO_CLIENT_MAX: usize = 4096;
/// Bytes for one write to the port.
const CHUNK: usize = 4096;
/// Most bytes that one call of `serve` takes from the client: several times what the bus carries
/// between two calls.
const INPUT_MAX: usize = 16 * 1024;
/// A full queue whose frames the bus has not taken for this long is dropped.
const BUS_TIMEOUT: Cycles = F_CPU_HZ;
/// Longest time that a closing channel waits for its last frames to go out.
const CLOSING_TIMEOUT: Cycles = F_CPU_HZ / 10;
/// Timestamps count milliseconds and start again each minute.
const TIMESTAMP_PERIOD_MS: u64 = 60_000;

/// Bits of the answer to `F`, as in the SJA1000-based adapters.
mod flag {
    pub const TO_CLIENT_FULL: u8 = 1 << 0;
    pub const TO_BUS_FULL: u8 = 1 << 1;
    pub const ERROR_WARNING: u8 = 1 << 2;
    pub const OVERRUN: u8 = 1 << 3;
    pub const ERROR_PASSIVE: u8 = 1 << 5;
    pub const ARBITRATION_LOST: u8 = 1 << 6;
    pub const BUS_ERROR: u8 = 1 << 7;
}

/// Error counters from this value on are a warning (ISO 11898-1).
const WARNING_LIMIT: u16 = 96;

/// The serial port between an adapter and its client.
pub trait Port {
    /// The name of the port for the user.
    fn name(&self) -> String;

    /// Bytes of the client.
    fn read(&mut self) -> Vec<u8>;

    /// Takes bytes for the client. Returns how many; the others are offered again.
    fn write(&mut self, bytes: &[u8]) -> usize;

    /// Drops the bytes that the client has not read.
    fn discard_unread(&mut self);
}

/// Mode in which a channel is open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ChannelMode {
    /// Sends, receives and acknowledges (`O`).
    Normal,
    /// Only receives (`L`).
    ListenOnly,
}

/// The adapter's station on the bus, with a node while the channel is open.
struct Place {
    node: Option<SoftNode>,
}

impl Station for Place {
    fn drive(&mut self, at: Cycles) -> Level {
        self.node.as_mut().map_or(Level::Recessive, |node| node.drive(at))
    }

    fn sample(&mut self, level: Level, at: Cycles) {
        if let Some(node) = &mut self.node {
            node.sample(level, at);
        }
    }

    fn quiet(&self, at: Cycles) -> bool {
        self.node.as_ref().is_none_or(|node| node.quiet(at))
    }

    fn transmitting(&self) -> bool {
        self.node.as_ref().is_some_and(SoftNode::transmitting)
    }

    fn bit_time_ps(&self) -> Option<u64> {
        self.node.as_ref().and_then(SoftNode::bit_time_ps)
    }

    fn skip_idle(&mut self, bits: u64) {
        if let Some(node) = &mut self.node {
            node.skip_idle(bits);
        }
    }

    fn follower(&mut self) -> Option<&mut Engine> {
        self.node.as_mut()?.follower()
    }
}

/// Queue of lines for the client.
#[derive(Default)]
struct Outbox {
    lines: VecDeque<Vec<u8>>,
    /// Rest of a write: begins within a line, so it must not be dropped.
    chunk: Vec<u8>,
}

impl Outbox {
    /// Queues a line. Returns true if the queue was full and dropped its oldest line.
    fn push(&mut self, line: Vec<u8>) -> bool {
        let full = self.lines.len() == TO_CLIENT_MAX;
        if full {
            self.lines.pop_front();
        }
        self.lines.push_back(line);
        full
    }

    fn write_to(&mut self, port: &mut impl Port) {
        loop {
            while self.chunk.len() < CHUNK
                && let Some(line) = self.lines.pop_front()
            {
                self.chunk.extend(line);
            }
            if self.chunk.is_empty() {
                return;
            }
            let taken = port.write(&self.chunk);
            self.chunk.drain(..taken);
            if !self.chunk.is_empty() {
                return;
            }
        }
    }
}

/// An SLCAN adapter with its port.
pub struct Slcan<P> {
    port: P,
    place: Rc<RefCell<Place>>,
    bit_rate: u32,
    /// True if the client requested another bit rate than that of the bus.
    wrong_rate: bool,
    hint: Option<String>,
    listen_only: bool,
    timestamps: bool,
    input: VecDeque<u8>,
    lines: Lines,
    outbox: Outbox,
    flags: u8,
    /// Last time at which the bus took a frame, or the queue was empty.
    moved_at: Cycles,
    closing_until: Option<Cycles>,
    to_bus: u64,
    to_client: u64,
    lost_to_bus: u64,
    lost_to_client: u64,
}

impl<P: Port> Slcan<P> {
    /// Adds an adapter to the bus, under this name, with its channel closed.
    pub fn attach(port: P, name: &str, bench: &mut Bench) -> Slcan<P> {
        let place = Rc::new(RefCell::new(Place { node: None }));
        bench.attach(name, place.clone());
        Slcan {
            port,
            place,
            bit_rate: bench.bus().bit_rate(),
            wrong_rate: false,
            hint: None,
            listen_only: false,
            timestamps: false,
            input: VecDeque::new(),
            lines: Lines::default(),
            outbox: Outbox::default(),
            flags: 0,
            moved_at: 0,
            closing_until: None,
            to_bus: 0,
            to_client: 0,
            lost_to_bus: 0,
            lost_to_client: 0,
        }
    }

    /// The port.
    pub fn port(&mut self) -> &mut P {
        &mut self.port
    }

    /// Frames dropped so far: those for the bus, and those for the client.
    pub fn lost(&self) -> (u64, u64) {
        (self.lost_to_bus, self.lost_to_client)
    }

    fn queued(&self) -> usize {
        self.place.borrow().node.as_ref().map_or(0, SoftNode::queued)
    }

    fn is_open(&self) -> bool {
        self.place.borrow().node.is_some()
    }

    fn receive_from_bus(&mut self, now: Cycles) {
        let (frames, events) = match &mut self.place.borrow_mut().node {
            Some(node) => (node.take_received(), node.take_events()),
            None => return,
        };
        for (_, event) in events {
            match event {
                Event::Transmitted(_) => {
                    self.to_bus += 1;
                    self.moved_at = now;
                }
                Event::ArbitrationLost => self.flags |= flag::ARBITRATION_LOST,
                Event::Error { .. } | Event::BusOff => self.flags |= flag::BUS_ERROR,
                _ => {}
            }
        }
        for (at, frame) in frames {
            let timestamp = (at * 1000 / F_CPU_HZ % TIMESTAMP_PERIOD_MS) as u16;
            let line = slcan::line(&frame, self.timestamps.then_some(timestamp));
            self.to_client += 1;
            if self.outbox.push(line) {
                self.lost_to_client += 1;
                self.flags |= flag::TO_CLIENT_FULL | flag::OVERRUN;
            }
        }
    }

    fn receive_from_client(&mut self, now: Cycles) {
        for _ in 0..INPUT_MAX {
            if self.closing_until.is_some() && !self.try_close(now) {
                return;
            }
            if self.queued() >= TO_BUS_MAX {
                if now - self.moved_at < BUS_TIMEOUT {
                    return;
                }
                self.drop_queue();
            }
            if self.input.is_empty() {
                self.input.extend(self.port.read());
            }
            let Some(byte) = self.input.pop_front() else {
                return;
            };
            match self.lines.push(byte) {
                None => {}
                Some(Ok(command)) => self.execute(command, now),
                Some(Err(())) => self.answer(ERROR),
            }
        }
    }

    fn drop_queue(&mut self) {
        if let Some(node) = &mut self.place.borrow_mut().node {
            let before = node.queued();
            node.clear_queue();
            self.lost_to_bus += (before - node.queued()) as u64;
        }
        self.flags |= flag::TO_BUS_FULL;
    }

    fn answer(&mut self, text: &[u8]) {
        self.outbox.push(text.to_vec());
    }

    fn execute(&mut self, command: Command, now: Cycles) {
        match command {
            Command::Nothing | Command::AcceptAll => self.answer(OK),
            Command::Version => self.answer(VERSION),
            Command::SerialNumber => self.answer(SERIAL_NUMBER),
            Command::Flags => {
                let flags = std::mem::take(&mut self.flags) | self.error_flags();
                self.answer(format!("F{flags:02X}\r").as_bytes());
            }
            Command::Timestamps(on) => {
                self.timestamps = on;
                self.answer(OK);
            }
            Command::BitRate(_) if self.is_open() => self.answer(ERROR),
            Command::BitRate(bit_rate) => {
                // At a wrong rate the bus would show only errors. `O` and `L` fail, too, because
                // some clients ignore the answer to `S` and would send.
                self.wrong_rate = bit_rate != self.bit_rate;
                if self.wrong_rate {
                    let (asked, bus) = (bit_rate / 1000, self.bit_rate / 1000);
                    let path = self.port.name();
                    self.hint = Some(format!(
                        "the client on {path} requested {asked} kbit/s, but the bus has {bus}: \
                         the adapter stays closed"
                    ));
                }
                self.answer(if self.wrong_rate { ERROR } else { OK });
            }
            Command::Open | Command::Listen if self.wrong_rate => self.answer(ERROR),
            Command::Open => self.open_channel(ChannelMode::Normal, now),
            Command::Listen => self.open_channel(ChannelMode::ListenOnly, now),
            Command::Close => {
                self.closing_until = Some(now + CLOSING_TIMEOUT);
                self.try_close(now);
            }
            Command::Send(frame) => self.send(frame, now),
        }
    }

    fn open_channel(&mut self, mode: ChannelMode, now: Cycles) {
        let listen_only = mode == ChannelMode::ListenOnly;
        let mut place = self.place.borrow_mut();
        if place.node.is_none() {
            self.flags = 0;
            self.moved_at = now;
        }
        place.node.get_or_insert_with(|| SoftNode::new(self.bit_rate)).set_listen_only(listen_only);
        drop(place);
        self.listen_only = listen_only;
        self.answer(OK);
    }

    /// Closes the channel if all frames are sent or `closing_until` is over. Returns true if the
    /// channel is closed.
    fn try_close(&mut self, now: Cycles) -> bool {
        let waiting = self.queued();
        if waiting > 0 && self.closing_until.is_some_and(|until| now < until) {
            return false;
        }
        self.closing_until = None;
        self.lost_to_bus += waiting as u64;
        if self.place.borrow_mut().node.take().is_some() {
            // After the next `O` the client must not get frames from before it.
            self.outbox.lines.clear();
            self.port.discard_unread();
        }
        self.answer(OK);
        true
    }

    fn send(&mut self, frame: Frame, now: Cycles) {
        let mut place = self.place.borrow_mut();
        let Some(node) = place.node.as_mut().filter(|_| !self.listen_only) else {
            drop(place);
            return self.answer(ERROR);
        };
        if node.queued() == 0 {
            self.moved_at = now;
        }
        node.send(frame);
        drop(place);
        self.answer(if frame.is_extended() { b"Z\r" } else { b"z\r" });
    }

    fn error_flags(&self) -> u8 {
        let place = self.place.borrow();
        let Some(node) = &place.node else {
            return 0;
        };
        let warning = node.tec().max(node.rec()) >= WARNING_LIMIT;
        let passive = node.error_state() != ErrorState::Active;
        (if warning { flag::ERROR_WARNING } else { 0 })
            | (if passive { flag::ERROR_PASSIVE } else { 0 })
    }

    /// Carries frames between the port and the bus. Call each simulated millisecond or more often.
    pub fn serve(&mut self, bench: &Bench) {
        let now = bench.now();
        self.receive_from_bus(now);
        self.receive_from_client(now);
        self.outbox.write_to(&mut self.port);
    }

    /// The state of the adapter, in words.
    pub fn status(&self) -> String {
        let state = if self.is_open() { "open" } else { "closed" };
        let (name, lost) = (self.port.name(), self.lost_to_bus + self.lost_to_client);
        format!(
            "slcan {name}: {state}, {} frames in, {} out, {lost} lost",
            self.to_bus, self.to_client
        )
    }

    /// What the user is told, once.
    pub fn take_hint(&mut self) -> Option<String> {
        self.hint.take()
    }
}
