//! What the node counts and logs: its health, its transfers, and the line about the current one.

use dronecan_wire::Rejection;
use mcp2515_ordered::Frame;

use super::health::{Health, count};
use crate::dialect;
use crate::monitor::{Event, Line, Monitor};
use crate::parts::stats::Stats;
use crate::tables::condition::Conditions;

/// The record.
pub struct Record {
    /// Conditions and counters.
    pub health: Health,
    /// The counters of the transfers.
    pub stats: Stats,
    /// The log line about the current transfer.
    pub note: Event,
}

impl Record {
    /// Nothing has happened.
    pub const fn new() -> Self {
        Self { health: Health::new(), stats: Stats::new(), note: Event::new(Line::Status) }
    }

    /// Logs a line with the values of the note.
    #[inline(never)]
    pub fn log(&mut self, line: Line, monitor: &mut Monitor) {
        self.note.set_line(line);
        if line != Line::NONE
            && let Some(event) = monitor.log_frame(line)
        {
            *event = self.note;
        }
    }

    /// Counts and logs a frame that is dropped.
    #[inline(never)]
    pub fn reject(&mut self, rejection: Rejection, frame: &Frame, monitor: &mut Monitor) {
        let (data_type, source) = dialect::origin(frame);
        self.lose(rejection, data_type, source, monitor);
    }

    /// Counts and logs a frame or a transfer that is dropped.
    #[inline(never)]
    pub fn lose(
        &mut self,
        rejection: Rejection,
        data_type: u16,
        source: u8,
        monitor: &mut Monitor,
    ) {
        if rejection == Rejection::OwnId {
            self.health.happened(Conditions::ID_CONFLICT);
        } else if rejection.is_loss() {
            self.stats.count_broken();
            self.health.happened(Conditions::TRANSFER_ERRORS);
        }
        count(&mut self.health.counts.refused);
        let line = match rejection {
            Rejection::Unknown => Line::RefusedKind,
            Rejection::Anonymous | Rejection::OwnId => Line::RefusedSource,
            Rejection::Malformed => Line::RefusedTransfer,
            Rejection::Busy => Line::RefusedBusy,
            Rejection::Broken => Line::RefusedBroken,
            Rejection::Interleaved => Line::RefusedInterleaved,
            Rejection::Length => Line::RefusedLength,
        };
        if let Some(event) = monitor.log_frame(line) {
            event.set_a(data_type);
            event.set_source(source);
        }
    }
}
