//! Error signalling: error flags, overload flags, their delimiter,
//! their increments of the counters, bus-off and the recovery from it.
//!
//! Source: ISO 11898-1:2003 10.4.4 (error frame), 10.4.5 (overload frame), 13.1 (fault
//! confinement).

use super::{Engine, EngineMode, IDLE_BITS, PassiveFlag, State};
use crate::confinement::{Confinement, ErrorState};
use crate::event::{ErrorKind, Event, Events};
use crate::wire::Level;

/// Number of dominant bits of an active error flag and of an overload flag, and of equal bits of a
/// passive error flag.
const FLAG_BITS: u8 = 6;
/// Number of recessive bits of an error or overload delimiter.
pub(super) const DELIMITER_BITS: u8 = 8;
/// After its flag a node tolerates seven dominant bits. The eighth, and every eighth after it,
/// increments the counter.
const DOMINANT_LIMIT: u8 = 8;
/// Number of sequences of `IDLE_BITS` recessive bits that end bus-off.
const RECOVERY_SEQUENCES: u8 = 128;

/// Increment of a counter by an error.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Charge {
    /// 8 for a transmitter, 1 for a receiver.
    Usual,
    /// 8 for both: a bit error in a flag.
    InFlag,
    /// Nothing.
    None,
}

impl Engine {
    /// The ACK slot of the node's frame stayed recessive.
    pub(super) fn acknowledge_error(&mut self, events: &mut Events) {
        if self.error_state() != ErrorState::Passive {
            return self.error(ErrorKind::Ack, Charge::Usual, events);
        }
        // Rule c), exception 1: counted only if a dominant bit appears during the passive flag.
        self.error(ErrorKind::Ack, Charge::None, events);
        self.begin_passive_flag(true);
    }

    /// An error in a frame, in a bit of this level.
    pub(super) fn frame_error(&mut self, kind: ErrorKind, level: Level, events: &mut Events) {
        if self.mode == EngineMode::ListenOnly {
            events.push(Event::Error { kind, transmitting: false });
            self.resync(level);
        } else {
            self.error(kind, Charge::Usual, events);
        }
    }

    /// An error, for a node that may signal it.
    pub(super) fn error(&mut self, kind: ErrorKind, charge: Charge, events: &mut Events) {
        let passive = self.error_state() == ErrorState::Passive;
        self.sending = None;
        events.push(Event::Error { kind, transmitting: self.transmitter });
        match (charge, self.transmitter) {
            (Charge::None, _) => {}
            (_, true) => self.counters.transmit_error(),
            (Charge::Usual, false) => self.counters.receive_error(),
            (Charge::InFlag, false) => self.counters.severe_receive_error(),
        }
        if self.enter_bus_off_if_due(events) {
        } else if passive {
            self.begin_passive_flag(false);
        } else {
            self.begin_flag(false);
        }
    }

    /// Starts an overload frame, in a bit of this level.
    pub(super) fn overload(&mut self, level: Level, events: &mut Events) {
        events.push(Event::Overload);
        if self.mode == EngineMode::ListenOnly {
            self.resync(level);
        } else {
            self.begin_flag(true);
        }
    }

    fn begin_flag(&mut self, overload: bool) {
        self.state = State::Flag { sent: 0, overload };
    }

    fn begin_passive_flag(&mut self, unacknowledged: bool) {
        let flag = PassiveFlag { run: 0, last: Level::Recessive, unacknowledged };
        self.state = State::PassiveFlag { flag };
    }

    fn resync(&mut self, level: Level) {
        let recessive = level as u8;
        self.state = State::Resync { recessive };
    }

    pub(super) fn sample_flag(
        &mut self,
        sent: u8,
        overload: bool,
        dominant: bool,
        events: &mut Events,
    ) {
        let sent = sent + 1;
        if !dominant {
            self.error(ErrorKind::Bit, Charge::InFlag, events);
        } else if sent == FLAG_BITS {
            self.begin_tail(!overload);
        } else {
            self.state = State::Flag { sent, overload };
        }
    }

    pub(super) fn sample_passive_flag(
        &mut self,
        flag: PassiveFlag,
        level: Level,
        events: &mut Events,
    ) {
        if flag.unacknowledged && level.is_dominant() {
            self.counters.transmit_error();
            if self.enter_bus_off_if_due(events) {
                return;
            }
        }
        let unacknowledged = flag.unacknowledged && !level.is_dominant();
        let run = if level == flag.last { flag.run + 1 } else { 1 };
        let last = level;
        if run == FLAG_BITS {
            self.begin_tail(true);
        } else {
            let flag = PassiveFlag { run, last, unacknowledged };
            self.state = State::PassiveFlag { flag };
        }
    }

    fn begin_tail(&mut self, first: bool) {
        self.state = State::FlagTail { dominant: 0, first };
    }

    pub(super) fn sample_flag_tail(
        &mut self,
        count: u8,
        first: bool,
        dominant: bool,
        events: &mut Events,
    ) {
        if !dominant {
            self.state = State::Delimiter { recessive: 1 };
            return;
        }
        if first && !self.transmitter {
            // Rule b): this node was the first to detect the error.
            self.counters.severe_receive_error();
        }
        let mut count = count + 1;
        if count == DOMINANT_LIMIT {
            // Rule f).
            count = 0;
            if self.transmitter {
                self.counters.transmit_error();
            } else {
                self.counters.severe_receive_error();
            }
        }
        if !self.enter_bus_off_if_due(events) {
            self.state = State::FlagTail { dominant: count, first: false };
        }
    }

    pub(super) fn sample_delimiter(&mut self, recessive: u8, dominant: bool, events: &mut Events) {
        let recessive = recessive + 1;
        let last = recessive == DELIMITER_BITS;
        match (dominant, last) {
            (false, false) => self.state = State::Delimiter { recessive },
            (false, true) => self.state = State::Intermission { bit: 0 },
            (true, false) => self.error(ErrorKind::Form, Charge::Usual, events),
            (true, true) => self.overload(Level::Dominant, events),
        }
    }

    /// Goes bus-off if the transmit error counter requires it. Returns true then.
    fn enter_bus_off_if_due(&mut self, events: &mut Events) -> bool {
        let off = self.error_state() == ErrorState::BusOff;
        if off {
            self.drop_frame();
            self.begin_recovery();
            events.push(Event::BusOff);
        }
        off
    }

    pub(super) fn begin_recovery(&mut self) {
        self.state = State::BusOff { recessive: 0, sequences: 0 };
    }

    pub(super) fn sample_bus_off(
        &mut self,
        recessive: u8,
        sequences: u8,
        dominant: bool,
        events: &mut Events,
    ) {
        let (mut recessive, mut sequences) = (recessive + 1, sequences);
        if dominant {
            recessive = 0;
        } else if recessive == IDLE_BITS {
            recessive = 0;
            sequences += 1;
        }
        if sequences == RECOVERY_SEQUENCES {
            self.counters = Confinement::default();
            self.state = State::Idle;
            events.push(Event::Recovered);
        } else {
            self.state = State::BusOff { recessive, sequences };
        }
    }
}
