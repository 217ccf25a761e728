//! The bus's own record of its traffic: a silent engine listens, and the recorder stores its
//! events.
//!
//! A frame is recorded when its end of frame is over, an error frame when its delimiter is. The
//! kind of an error is the one that a listener detects. The station that found it first may have
//! detected another kind: a bit error looks like a stuff error to others. Overload frames are only
//! counted.

use super::Frame;
use super::engine::Engine;
use super::event::{ErrorKind, Event};
use super::parser::Field;
use super::port::PortId;
use super::wire::{INTERMISSION_BITS, Level};
use sim_base::Cycles;
use std::collections::VecDeque;

/// Maximum number of stored records. The oldest are dropped and counted. About 8 s of a fully
/// loaded bus at 1 Mbit/s.
const RECORD_LIMIT: usize = 65_536;

/// A frame or an error frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RecordKind {
    /// A complete frame.
    Frame {
        /// The frame.
        frame: Frame,
        /// The sender; `None` if no station that is attached and in step sent it.
        from: Option<PortId>,
        /// True if its ACK slot was dominant.
        acked: bool,
    },
    /// A frame that was destroyed.
    ErrorFrame {
        /// The error that a listener detected.
        kind: Option<ErrorKind>,
        /// The sender, if it was known already. Also `None` if noise and no station began the
        /// frame.
        from: Option<PortId>,
    },
}

/// One frame or error frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Record {
    /// Start of the SOF.
    pub start: Cycles,
    /// End of the last end-of-frame bit, or of the error delimiter.
    pub end: Cycles,
    /// Number of bits in between, including stuff bits.
    pub bits: u32,
    /// The kind of record.
    pub kind: RecordKind,
}

/// Totals of one station.
#[derive(Clone, PartialEq, Eq, Default, Debug)]
pub struct PortStats {
    /// The name with which it was attached.
    pub name: String,
    /// Number of complete frames.
    pub frames: u64,
    /// Number of their bits, including intermissions.
    pub bits: u64,
}

/// Totals since the bus was created.
#[derive(Clone, PartialEq, Eq, Default, Debug)]
pub struct BusStats {
    /// Number of complete frames.
    pub frames: u64,
    /// Number of error frames.
    pub error_frames: u64,
    /// Number of overload frames.
    pub overload_frames: u64,
    /// Number of bits of frames, error and overload frames, and intermissions.
    pub busy_bits: u64,
    /// Number of all bits.
    pub total_bits: u64,
    /// Number of records that were dropped because they were not taken in time.
    pub lost_records: u64,
    /// Per station, in the order of attachment.
    pub ports: Vec<PortStats>,
}

impl BusStats {
    /// Part of the bits since `earlier` that were busy, 0 to 1.
    pub fn load_since(&self, earlier: &BusStats) -> f64 {
        let total = self.total_bits - earlier.total_bits;
        if total == 0 { 0.0 } else { (self.busy_bits - earlier.busy_bits) as f64 / total as f64 }
    }
}

/// See the [module documentation](self).
#[derive(Debug)]
pub(super) struct Recorder {
    observer: Engine,
    pub stats: BusStats,
    records: VecDeque<Record>,
    /// The frame on the wire now.
    start: Cycles,
    bits: u32,
    sender: Option<PortId>,
    acked: bool,
    accepted: Option<Frame>,
    error: Option<ErrorKind>,
}

impl Recorder {
    pub fn new() -> Recorder {
        Recorder {
            observer: Engine::observer(),
            stats: BusStats::default(),
            records: VecDeque::new(),
            start: 0,
            bits: 0,
            sender: None,
            acked: false,
            accepted: None,
            error: None,
        }
    }

    /// The engine that receives each bit of the wire.
    pub fn observer(&self) -> &Engine {
        &self.observer
    }

    /// True if no frame is in progress.
    pub fn is_idle(&self) -> bool {
        self.observer.is_idle()
    }

    /// True if a dominant bit now would be a SOF.
    pub fn is_free_for_sof(&self) -> bool {
        self.observer.is_free_for_sof()
    }

    /// True if the next bit is an ACK slot.
    pub fn is_ack_slot(&self) -> bool {
        self.observer.field() == Some(Field::AckSlot)
    }

    /// True if [`Recorder::set_sender`] should be called now: arbitration has just been
    /// decided, or the ACK slot is next.
    pub fn needs_sender(&self) -> bool {
        self.observer.is_past_arbitration() || self.is_ack_slot()
    }

    pub fn set_sender(&mut self, sender: Option<PortId>) {
        self.sender = sender;
    }

    pub fn skip_idle(&mut self, bits: u64) {
        self.stats.total_bits += bits;
    }

    /// Handles one bit.
    pub fn bit(&mut self, level: Level, start: Cycles, end: Cycles) {
        let field = self.observer.field();
        if level.is_dominant() && self.observer.is_free_for_sof() {
            self.begin(start);
        }
        let was_idle = self.observer.is_idle();
        // The recorder ignores the level to drive; a listener drives recessive.
        let events = self.observer.sample(level);
        self.stats.total_bits += 1;
        self.bits += 1;
        if was_idle && self.observer.is_idle() {
            return;
        }
        self.stats.busy_bits += 1;
        if field == Some(Field::AckSlot) {
            self.acked = level.is_dominant();
        }
        for event in events {
            self.note(event, field);
        }
        if self.accepted.is_some() && self.observer.field().is_none() {
            self.end_frame(end);
        } else if self.error.is_some() && !self.observer.is_resyncing() {
            self.end_error_frame(end);
        }
    }

    fn begin(&mut self, start: Cycles) {
        self.start = start;
        self.bits = 0;
        self.acked = false;
        self.accepted = None;
        self.error = None;
    }

    fn note(&mut self, event: Event, field: Option<Field>) {
        match event {
            Event::Received(frame) => self.accepted = Some(frame),
            Event::Error { kind, .. } => {
                // Without an acknowledgement the sender's error flag starts in the ACK delimiter.
                let unacknowledged = field == Some(Field::AckDelimiter) && !self.acked;
                let form = kind == ErrorKind::Form;
                self.error = Some(if unacknowledged && form { ErrorKind::Ack } else { kind });
            }
            Event::Overload => self.stats.overload_frames += 1,
            _ => {}
        }
    }

    fn end_frame(&mut self, end: Cycles) {
        let Some(frame) = self.accepted.take() else {
            return;
        };
        self.stats.frames += 1;
        // Removes the sender: noise on the idle bus has none.
        let from = self.sender.take();
        if let Some(port) = from {
            let stats = &mut self.stats.ports[port.0];
            stats.frames += 1;
            stats.bits += u64::from(self.bits) + u64::from(INTERMISSION_BITS);
        }
        self.record(end, RecordKind::Frame { frame, from, acked: self.acked });
    }

    fn end_error_frame(&mut self, end: Cycles) {
        self.stats.error_frames += 1;
        let kind = self.error.take();
        let from = self.sender.take();
        self.record(end, RecordKind::ErrorFrame { kind, from });
    }

    fn record(&mut self, end: Cycles, kind: RecordKind) {
        if self.records.len() == RECORD_LIMIT {
            self.records.pop_front();
            self.stats.lost_records += 1;
        }
        self.records.push_back(Record { start: self.start, end, bits: self.bits, kind });
    }

    pub fn take_records(&mut self) -> Vec<Record> {
        self.records.drain(..).collect()
    }
}
