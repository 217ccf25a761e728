//! A node with a perfect controller and endless queues: autopilot, host adapter, test peer, babbler.
//!
//! Frames go out in the order of their due times, and in the order of the calls where those are
//! equal; a frame that lost arbitration or met an error is sent again until it succeeds.
//!
//! Limits: received frames are kept until taken, without bound. Of the other events only the newest
//! [`EVENT_LIMIT`] are kept.

use super::Frame;
use super::confinement::ErrorState;
use super::engine::{Engine, EngineMode};
use super::event::Event;
use super::station::Station;
use super::wire::Level;
use sim_base::Cycles;
use std::collections::VecDeque;

/// A node that nobody asks for its events must not eat the host's memory: a lone sender makes one per
/// 150 us or so.
const EVENT_LIMIT: usize = 65_536;

const PS_PER_S: u64 = 1_000_000_000_000;

/// A node without a chip: what it should send goes in, what it heard comes out.
#[derive(Debug)]
pub struct SoftNode {
    engine: Engine,
    bit_time_ps: u64,
    /// Frames to send, sorted by due time.
    queue: VecDeque<(Cycles, Frame)>,
    babble: Option<Frame>,
    /// The frame on the wire is the babble, not the head of the queue.
    babbling: bool,
    /// Start or end of the latest bit.
    now: Cycles,
    received: Vec<(Cycles, Frame)>,
    events: VecDeque<(Cycles, Event)>,
}

impl SoftNode {
    /// A node at that many bits per second. It integrates (11 recessive bits) once it is attached.
    pub fn new(bit_rate: u32) -> SoftNode {
        assert!(bit_rate > 0, "a bit rate of 0");
        let mut engine = Engine::new();
        engine.set_mode(EngineMode::Normal);
        SoftNode {
            engine,
            bit_time_ps: PS_PER_S / u64::from(bit_rate),
            queue: VecDeque::new(),
            babble: None,
            babbling: false,
            now: 0,
            received: Vec::new(),
            events: VecDeque::new(),
        }
    }

    /// Queues a frame, to be sent as soon as the bus allows.
    pub fn send(&mut self, frame: Frame) {
        self.send_at(0, frame);
    }

    /// Queues a frame whose SOF must not come before `at`.
    pub fn send_at(&mut self, at: Cycles, frame: Frame) {
        // Not earlier than now, so that it cannot get in front of a frame already on the wire.
        let due = at.max(self.now);
        let place = self.queue.partition_point(|&(other, _)| other <= due);
        self.queue.insert(place, (due, frame));
    }

    /// Sends this frame back to back, in front of the queue, until told otherwise.
    pub fn babble(&mut self, frame: Option<Frame>) {
        self.babble = frame;
    }

    /// Frames not yet sent, the one on the wire included, the babble not.
    pub fn queued(&self) -> usize {
        self.queue.len()
    }

    /// Drops all frames not yet begun.
    pub fn clear_queue(&mut self) {
        let keep = usize::from(self.engine.transmitting() && !self.babbling);
        self.queue.truncate(keep);
    }

    /// Frames of other nodes since the last call, each with the end of the bit that made it valid.
    pub fn take_received(&mut self) -> Vec<(Cycles, Frame)> {
        std::mem::take(&mut self.received)
    }

    /// All other events since the last call, with the end of their bit.
    pub fn take_events(&mut self) -> Vec<(Cycles, Event)> {
        self.events.drain(..).collect()
    }

    /// Switches between taking part and only listening. The queue stays.
    pub fn set_listen_only(&mut self, listen_only: bool) {
        let mode = if listen_only { EngineMode::ListenOnly } else { EngineMode::Normal };
        self.engine.set_mode(mode);
    }

    /// Transmit error counter.
    pub fn tec(&self) -> u16 {
        self.engine.tec()
    }

    /// Receive error counter.
    pub fn rec(&self) -> u16 {
        self.engine.rec()
    }

    /// Error active, error passive or bus-off.
    pub fn error_state(&self) -> ErrorState {
        self.engine.error_state()
    }

    fn wants_to_send(&self, at: Cycles) -> bool {
        self.engine.mode() == EngineMode::Normal
            && (self.babble.is_some() || self.queue.front().is_some_and(|&(due, _)| due <= at))
    }

    fn note(&mut self, event: Event, at: Cycles) {
        match event {
            Event::Received(frame) => return self.received.push((at, frame)),
            Event::Transmitted(_) if !self.babbling => {
                self.queue.pop_front();
            }
            _ => {}
        }
        if self.events.len() == EVENT_LIMIT {
            self.events.pop_front();
        }
        self.events.push_back((at, event));
    }
}

impl Station for SoftNode {
    fn drive(&mut self, at: Cycles) -> Level {
        self.now = at;
        if self.engine.transmitting() {
            return self.engine.drive(None);
        }
        let due = self.queue.front().filter(|&&(due, _)| due <= at).map(|(_, frame)| frame);
        self.babbling = self.babble.is_some();
        self.engine.drive(self.babble.as_ref().or(due))
    }

    fn sample(&mut self, level: Level, at: Cycles) {
        self.now = at;
        let events = self.engine.sample(level);
        if !events.is_empty() {
            events.for_each(|event| self.note(event, at));
        }
    }

    fn quiet(&self, at: Cycles) -> bool {
        self.engine.is_idle() && !self.wants_to_send(at)
    }

    fn transmitting(&self) -> bool {
        self.engine.transmitting()
    }

    fn bit_time_ps(&self) -> Option<u64> {
        Some(self.bit_time_ps)
    }

    fn skip_idle(&mut self, _bits: u64) {}
}
