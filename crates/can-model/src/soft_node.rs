//! A node with an ideal controller and unlimited queues: autopilot, host adapter, test peer,
//! babbling node.
//!
//! Frames are sent in the order of their due times, or of the calls if these are
//! equal. A frame that lost arbitration or was destroyed is sent again until it succeeds.
//!
//! Limits: received frames are kept without limit until they are taken. Of the other events only
//! the newest [`EVENT_LIMIT`] are kept.

use super::Frame;
use super::confinement::ErrorState;
use super::engine::{Engine, EngineMode};
use super::event::Event;
use super::station::Station;
use super::wire::Level;
use sim_base::Cycles;
use std::collections::VecDeque;

/// Limits the memory of a node whose events are not taken: a single sender has one event per
/// 150 us or so.
const EVENT_LIMIT: usize = 65_536;

const PS_PER_S: u64 = 1_000_000_000_000;

/// A node without a chip: it sends queued frames and stores received ones.
#[derive(Debug)]
pub struct SoftNode {
    engine: Engine,
    bit_time_ps: u64,
    /// Frames to send, sorted by due time.
    queue: VecDeque<(Cycles, Frame)>,
    babble: Option<Frame>,
    /// True if the frame on the wire is the babbled one, not the head of the queue.
    babbling: bool,
    /// Start or end of the latest bit.
    now: Cycles,
    received: Vec<(Cycles, Frame)>,
    events: VecDeque<(Cycles, Event)>,
}

impl SoftNode {
    /// A node at `bit_rate` bits per second. It integrates (11 recessive bits) after it is
    /// attached.
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
        // Not earlier than now, so that it does not replace a frame already on the wire.
        let due = at.max(self.now);
        let place = self.queue.partition_point(|&(other, _)| other <= due);
        self.queue.insert(place, (due, frame));
    }

    /// Sends this frame back to back, before the queue, until called with `None`.
    pub fn babble(&mut self, frame: Option<Frame>) {
        self.babble = frame;
    }

    /// Number of frames not sent yet, with the one on the wire but without the babbled one.
    pub fn queued(&self) -> usize {
        self.queue.len()
    }

    /// Drops all frames that have not begun.
    pub fn clear_queue(&mut self) {
        let keep = usize::from(self.engine.transmitting() && !self.babbling);
        self.queue.truncate(keep);
    }

    /// Takes the frames of other nodes, each with the end of the bit that made it valid.
    pub fn take_received(&mut self) -> Vec<(Cycles, Frame)> {
        std::mem::take(&mut self.received)
    }

    /// Takes all other events, with the end of their bit.
    pub fn take_events(&mut self) -> Vec<(Cycles, Event)> {
        self.events.drain(..).collect()
    }

    /// Switches between normal and listen-only mode. The queue is kept.
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

    fn follower(&mut self) -> Option<&mut Engine> {
        Some(&mut self.engine)
    }
}
