//! The CAN 2.0B protocol engine of one node, one bit at a time.
//!
//! Each bit is a pair of calls: [`Engine::drive`] returns the level that the node drives, and
//! [`Engine::sample`] gets the level of the wire and returns the resulting events.
//!
//! ```text
//! Integrating --11 r--> Idle --SOF--> Frame --EOF--> Intermission --3 r--> Idle (or Suspend, 8 r)
//!           error: Frame --> Flag | PassiveFlag --> FlagTail --> Delimiter --> Intermission
//!                     overload: Intermission, last bit of EOF or Delimiter --> Flag --> FlagTail
//!          listen-only, error: Frame --> Resync --8 r--> Intermission
//!                    TEC > 255: BusOff --128 x 11 r--> Idle
//! ```
//!
//! Goal: every rule of arbitration, signalling and fault confinement, with its exceptions, at its
//! exact bit.
//!
//! Invariants:
//! * `sending` is set only in `Frame`. `transmitter` stays set longer: a node is transmitter until
//!   the end of its error frame and of the intermission. That decides which counter is incremented.
//! * In `Frame` the parser gets every bit of the wire, also of the node's own frame, so a node that
//!   loses arbitration continues as a receiver without a gap.
//! * A flag is active or passive by the state before its error was counted: the flag of the error
//!   that makes a node passive is still active.
//!
//! Choices that the specification leaves open:
//! * A dominant bit that a transmitter sees in its end of frame is a bit error, not a form error
//!   (its weight is the same), as in Bosch's controllers.
//! * A bit error in an active error flag or overload flag starts a new error flag.
//! * A receiver whose dominant acknowledgement reads back recessive has a bit error.
//! * A node in listen-only mode resumes after an error when it has received eight recessive bits,
//!   including the error's own bit. ISO 11898-1 allows that it sends its error flag internally and
//!   so misses frames after an error; this node does not.
//!
//! Source: ISO 11898-1:2003 clauses 10 (formats, error handling) and 13 (fault confinement); Bosch
//! CAN Specification 2.0 part B.

mod signalling;

use signalling::{Charge, DELIMITER_BITS};

use super::Frame;
use super::confinement::{Confinement, ErrorState};
use super::event::{ErrorKind, Event, Events};
use super::parser::{Field, Parser, Step};
use super::wire::{INTERMISSION_BITS, Level, WireBits};

/// Recessive bits that an error-passive transmitter waits after the intermission.
const SUSPEND_BITS: u8 = 8;
/// Consecutive recessive bits after which the bus is idle for a node.
const IDLE_BITS: u8 = 11;

/// Modes of an [`Engine`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EngineMode {
    /// Drives recessive and receives nothing. The counters keep their values until
    /// [`Engine::reset`].
    Off,
    /// Sends and receives.
    Normal,
    /// Receives frames and drives nothing: no frames, acknowledgements or flags. The counters stay
    /// 0.
    ListenOnly,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    Off,
    /// Waits for an idle bus after a start.
    Integrating {
        recessive: u8,
    },
    Idle,
    /// SOF to end of frame.
    Frame,
    Intermission {
        bit: u8,
    },
    Suspend {
        bit: u8,
    },
    /// Sending an active error flag or an overload flag.
    Flag {
        sent: u8,
        overload: bool,
    },
    PassiveFlag {
        flag: PassiveFlag,
    },
    /// The flag is sent; other nodes may still send theirs.
    FlagTail {
        dominant: u8,
        /// True if the next bit is the first after an error flag.
        first: bool,
    },
    Delimiter {
        recessive: u8,
    },
    /// Listen-only, after an error or overload.
    Resync {
        recessive: u8,
    },
    BusOff {
        recessive: u8,
        sequences: u8,
    },
}

/// The received part of a passive error flag.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct PassiveFlag {
    /// Number of consecutive equal bits, and their level.
    run: u8,
    last: Level,
    /// True for an ACK error, which is counted only if another node signals an error too.
    unacknowledged: bool,
}

/// The frame being sent.
#[derive(Clone, Copy, Debug)]
struct Sending {
    frame: Frame,
    bits: WireBits,
    /// Next bit to drive.
    at: u8,
}

/// Protocol engine of one node. Starts [`EngineMode::Off`].
#[derive(Clone, Debug)]
pub struct Engine {
    mode: EngineMode,
    state: State,
    parser: Parser,
    sending: Option<Sending>,
    transmitter: bool,
    /// True if the last SOF was in the third bit of the intermission: the node may join with its
    /// own frame from the first identifier bit on.
    may_join: bool,
    driven: Level,
    counters: Confinement,
    self_ack: bool,
}

impl Default for Engine {
    fn default() -> Engine {
        Engine::new()
    }
}

impl Engine {
    /// An engine that is off, with its counters at zero.
    pub fn new() -> Engine {
        Engine {
            mode: EngineMode::Off,
            state: State::Off,
            parser: Parser::new(),
            sending: None,
            transmitter: false,
            may_join: false,
            driven: Level::Recessive,
            counters: Confinement::default(),
            self_ack: false,
        }
    }

    /// A listener that need not integrate, because the bus is new.
    pub(super) fn observer() -> Engine {
        Engine { mode: EngineMode::ListenOnly, state: State::Idle, ..Engine::new() }
    }

    /// Changes the mode. A frame in progress is dropped without an event. The node then integrates
    /// (11 recessive bits); if its counters say bus-off, it starts its recovery again. Setting the
    /// same mode changes nothing.
    pub fn set_mode(&mut self, mode: EngineMode) {
        if mode == self.mode {
            return;
        }
        self.mode = mode;
        self.drop_frame();
        if mode == EngineMode::ListenOnly {
            self.counters = Confinement::default();
        }
        if mode == EngineMode::Off {
            self.state = State::Off;
        } else if self.error_state() == ErrorState::BusOff {
            self.begin_recovery();
        } else {
            self.state = State::Integrating { recessive: 0 };
        }
    }

    /// The mode last set.
    pub fn mode(&self) -> EngineMode {
        self.mode
    }

    /// Loopback: on its own wire the node acknowledges its own frames and receives them. Its
    /// owner returns the driven level at once: `sample(drive(pending))`.
    pub fn set_self_ack(&mut self, self_ack: bool) {
        self.self_ack = self_ack;
    }

    /// Resets to the initial state: off, counters at zero, no loopback.
    pub fn reset(&mut self) {
        *self = Engine::new();
    }

    /// Restarts and keeps the error counters: drops a frame in progress and waits for an idle bus.
    pub fn restart(&mut self) {
        *self = Engine { counters: std::mem::take(&mut self.counters), ..Engine::new() };
    }

    /// Transmit error counter. Above 255 the node is bus-off.
    pub fn tec(&self) -> u16 {
        self.counters.tec
    }

    /// Receive error counter, at most 255.
    pub fn rec(&self) -> u16 {
        self.counters.rec
    }

    /// The error state, from the counters.
    pub fn error_state(&self) -> ErrorState {
        self.counters.state()
    }

    /// True from the SOF of an own frame to its last bit, a lost arbitration or an error.
    pub fn transmitting(&self) -> bool {
        self.sending.is_some()
    }

    /// True if the bus is idle for this node: no frame in progress, and nothing to wait for.
    pub fn is_idle(&self) -> bool {
        self.state == State::Idle
    }

    /// After an [`Event::Error`] in listen-only mode: the frame that was broken, with zeros for the
    /// data that had not arrived. `None` if the control field had not arrived.
    pub fn broken_frame(&self) -> Option<Frame> {
        self.parser.has_control_field().then(|| self.parser.frame())
    }

    /// True if a dominant bit now would be a SOF.
    pub(super) fn is_free_for_sof(&self) -> bool {
        matches!(self.state, State::Idle | State::Intermission { bit: 2 })
    }

    /// True from the bit after an error or overload to the end of the delimiter (listen-only).
    pub(super) fn is_resyncing(&self) -> bool {
        matches!(self.state, State::Resync { .. })
    }

    /// The field of the next bit; `None` outside frames.
    pub(super) fn field(&self) -> Option<Field> {
        (self.state == State::Frame).then(|| self.parser.field())
    }

    /// True if the next bit is the first after the arbitration field (and reserved bits).
    pub(super) fn is_past_arbitration(&self) -> bool {
        self.state == State::Frame && self.parser.is_past_arbitration()
    }

    /// The level that the node drives in the next bit. `pending` is the frame that the owner wants
    /// to send. If this bit can be its SOF, the engine copies it, and [`Engine::transmitting`]
    /// becomes true. After a lost arbitration or an error the owner must pass it again.
    pub fn drive(&mut self, pending: Option<&Frame>) -> Level {
        self.driven = match self.state {
            State::Frame => self.drive_frame(pending),
            State::Idle => match pending {
                Some(frame) if self.mode == EngineMode::Normal => {
                    self.state = State::Frame;
                    self.parser = Parser::new();
                    self.begin_sending(frame, 0)
                }
                _ => Level::Recessive,
            },
            State::Flag { .. } => Level::Dominant,
            _ => Level::Recessive,
        };
        self.driven
    }

    fn drive_frame(&mut self, pending: Option<&Frame>) -> Level {
        if self.may_join {
            self.may_join = false;
            if let (Some(frame), EngineMode::Normal) = (pending, self.mode) {
                // Another node has sent the SOF.
                return self.begin_sending(frame, 1);
            }
        }
        let acknowledging = self.parser.wants_acknowledgement();
        match &mut self.sending {
            Some(sending) => {
                let level = sending.bits.get(sending.at);
                sending.at += 1;
                if acknowledging && self.self_ack { Level::Dominant } else { level }
            }
            None if acknowledging && self.mode == EngineMode::Normal => Level::Dominant,
            None => Level::Recessive,
        }
    }

    /// True if this engine, which gets each bit of the wire, is in the same frame as `other`, and
    /// nothing but the frame's bits decides what it does.
    pub(super) fn follows(&self, other: &Engine) -> bool {
        self.state == State::Frame && !self.may_join && self.parser == other.parser
    }

    /// The frame being sent, and the number of its bits that are over.
    pub(super) fn sent(&self) -> Option<(WireBits, u8)> {
        self.sending.map(|sending| (sending.bits, sending.at))
    }

    /// Passes this number of bits, after which the parser is that of `other`.
    pub(super) fn follow(&mut self, other: &Engine, bits: u8) {
        self.parser = other.parser;
        if let Some(sending) = &mut self.sending {
            sending.at += bits;
        }
    }

    fn begin_sending(&mut self, frame: &Frame, at: u8) -> Level {
        let bits = WireBits::of(frame);
        self.sending = Some(Sending { frame: *frame, bits, at: at + 1 });
        self.transmitter = true;
        bits.get(at)
    }

    /// The level of the wire in the bit that [`Engine::drive`] began. Returns its events.
    #[inline]
    pub fn sample(&mut self, level: Level) -> Events {
        let mut events = Events::default();
        // The most frequent case, first.
        if matches!(self.state, State::Frame) {
            self.sample_frame(level, &mut events);
        } else {
            self.sample_between_frames(level, &mut events);
        }
        events
    }

    fn sample_between_frames(&mut self, level: Level, events: &mut Events) {
        let dominant = level.is_dominant();
        match self.state {
            State::Frame => unreachable!("sample() sees to it"),
            State::Idle => {
                if dominant {
                    self.start_of_frame(false);
                }
            }
            State::Off => {}
            State::Integrating { recessive } => {
                self.state = match (dominant, recessive + 1) {
                    (true, _) => State::Integrating { recessive: 0 },
                    (false, IDLE_BITS) => State::Idle,
                    (false, recessive) => State::Integrating { recessive },
                };
            }
            State::Intermission { bit } => self.sample_intermission(bit, dominant, events),
            State::Suspend { bit } => {
                if dominant {
                    self.start_of_frame(false);
                } else if bit + 1 == SUSPEND_BITS {
                    self.enter_idle();
                } else {
                    self.state = State::Suspend { bit: bit + 1 };
                }
            }
            State::Flag { sent, overload } => {
                self.sample_flag(sent, overload, dominant, events);
            }
            State::PassiveFlag { flag } => self.sample_passive_flag(flag, level, events),
            State::FlagTail { dominant: count, first } => {
                self.sample_flag_tail(count, first, dominant, events)
            }
            State::Delimiter { recessive } => {
                self.sample_delimiter(recessive, dominant, events);
            }
            State::Resync { recessive } => {
                self.state = match (dominant, recessive + 1) {
                    (true, _) => State::Resync { recessive: 0 },
                    (false, DELIMITER_BITS) => State::Intermission { bit: 0 },
                    (false, recessive) => State::Resync { recessive },
                };
            }
            State::BusOff { recessive, sequences } => {
                self.sample_bus_off(recessive, sequences, dominant, events);
            }
        }
    }

    fn sample_frame(&mut self, level: Level, events: &mut Events) {
        if let Some(sending) = &self.sending {
            let field = self.parser.field();
            if level == self.driven {
                if field == Field::AckSlot && !level.is_dominant() {
                    return self.acknowledge_error(events);
                }
            } else if self.driven.is_dominant() {
                return self.frame_error(ErrorKind::Bit, level, events);
            } else if self.parser.is_arbitrating(sending.frame.is_extended()) {
                if self.parser.expects_stuff_bit() {
                    // Rule c), exception 2: another node may have sent a stuff bit of its frame.
                    return self.error(ErrorKind::Stuff, Charge::None, events);
                }
                self.sending = None;
                self.transmitter = false;
                events.push(Event::ArbitrationLost);
            } else if field != Field::AckSlot {
                return self.frame_error(ErrorKind::Bit, level, events);
            }
        } else if self.driven.is_dominant() && !level.is_dominant() {
            return self.frame_error(ErrorKind::Bit, level, events);
        }
        match self.parser.push(level) {
            Step::More => {}
            Step::Acknowledged => {
                if self.sending.is_none() && self.mode == EngineMode::Normal {
                    self.counters.received();
                }
            }
            Step::Valid => {
                if self.sending.is_none() || self.self_ack {
                    events.push(Event::Received(self.parser.frame()));
                }
            }
            Step::End => {
                if let Some(sending) = self.sending.take() {
                    self.counters.transmitted();
                    events.push(Event::Transmitted(sending.frame));
                }
                self.state = State::Intermission { bit: 0 };
            }
            Step::EndDominant => self.overload(level, events),
            Step::StuffError => self.frame_error(ErrorKind::Stuff, level, events),
            Step::CrcError => self.frame_error(ErrorKind::Crc, level, events),
            Step::FormError => self.frame_error(ErrorKind::Form, level, events),
        }
    }

    fn sample_intermission(&mut self, bit: u8, dominant: bool, events: &mut Events) {
        let last = bit + 1 == INTERMISSION_BITS;
        let suspended = self.transmitter && self.error_state() == ErrorState::Passive;
        if dominant && last {
            self.start_of_frame(!suspended);
        } else if dominant {
            self.overload(Level::Dominant, events);
        } else if !last {
            self.state = State::Intermission { bit: bit + 1 };
        } else if suspended {
            self.state = State::Suspend { bit: 0 };
        } else {
            self.enter_idle();
        }
    }

    /// A dominant bit of another node begins a frame.
    fn start_of_frame(&mut self, may_join: bool) {
        self.state = State::Frame;
        self.transmitter = false;
        self.may_join = may_join;
        self.parser = Parser::new();
        self.parser.push(Level::Dominant);
    }

    fn enter_idle(&mut self) {
        self.state = State::Idle;
        self.transmitter = false;
    }

    fn drop_frame(&mut self) {
        self.sending = None;
        self.transmitter = false;
        self.may_join = false;
        self.driven = Level::Recessive;
    }
}
