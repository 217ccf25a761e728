//! The queue of the requests of clients: the node responds to one at a time and in order. The
//! response to a SAVE waits until the save is over; with the feature `save-answers` the others go
//! first.

use crate::monitor::{Line, Monitor};
use crate::parts::update::{self, Verdict};
use crate::tables::kind::Kind;
use crate::tables::wire::Transfer;

/// Requests that can wait for their response. A power of two. GUI tools send five at once.
const WAITING: usize = 8;

/// Least time from a request to restart to the restart, in milliseconds. In this time the servo
/// reaches its failsafe position, and the response leaves.
const RESTART_MS: u16 = 100;

/// The same if the responses have not left until then, because the bus is full.
const UNSENT_MS: u16 = 1000;

/// True if other responses go before the one that waits for a save.
pub const ANSWERS_WHILE_SAVING: bool = cfg!(feature = "save-answers");

/// A request that waits for its response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pending {
    /// The service.
    pub kind: Kind,
    /// The client.
    pub to: u8,
    /// The priority of the request.
    pub priority: u8,
    /// The transfer ID of the request.
    pub transfer_id: u8,
    /// GetSet: the index of the parameter. ExecuteOpcode, RestartNode: 1 if accepted, else 0.
    /// BeginFirmwareUpdate: the verdict.
    pub argument: u8,
    /// GetSet: the value after the request.
    pub value: u16,
}

/// The result of an action on a request.
pub struct Reply {
    /// The line to log. Unless it is a refusal, the request is queued for its response.
    pub line: Line,
    /// See [`Pending`].
    pub argument: u8,
    /// The same.
    pub value: u16,
}

impl Reply {
    /// A reply that needs nothing else.
    pub const fn of(line: Line) -> Self {
        Self { line, argument: 0, value: 0 }
    }
}

/// What else a response needs.
pub struct Response<'a, C, P> {
    /// The time, in milliseconds.
    pub now_ms: u16,
    /// The counters of the controller.
    pub counters: &'a C,
    /// The tables in flash.
    pub flash: P,
    /// The log.
    pub monitor: &'a mut Monitor,
}

impl Pending {
    const NONE: Self =
        Self { kind: Kind::Unknown, to: 0, priority: 0, transfer_id: 0, argument: 0, value: 0 };
}

/// The pending requests.
pub struct Services {
    /// A ring that starts at `first`.
    waiting: [Pending; WAITING],
    first: u8,
    count: u8,
    /// True once a request to restart was accepted, or one for an update.
    is_to_restart: bool,
    /// True once a request to restart was accepted: only an update is called off.
    is_asked_to_restart: bool,
    /// When that was, or the end of the save during which it was, in milliseconds. Valid if
    /// `is_to_restart`.
    accepted_ms: u16,
}

impl Services {
    /// No pending requests.
    pub const fn new() -> Self {
        Self {
            waiting: [Pending::NONE; WAITING],
            first: 0,
            count: 0,
            is_to_restart: false,
            is_asked_to_restart: false,
            accepted_ms: 0,
        }
    }

    /// True if the queue has no room for another request.
    pub fn is_full(&self) -> bool {
        self.count == WAITING as u8
    }

    /// True if no request is pending.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The request `behind` places after the oldest.
    #[inline(never)]
    pub fn place(&mut self, behind: u8) -> &mut Pending {
        &mut self.waiting[usize::from(self.first + behind) % WAITING]
    }

    /// Adds a request. There must be room. `argument` and `value` are those of its response.
    pub fn add(&mut self, request: &Transfer, argument: u8, value: u16, now_ms: u16) {
        let pending = self.place(self.count);
        pending.kind = request.kind;
        pending.to = request.source;
        pending.priority = request.priority;
        pending.transfer_id = request.transfer_id();
        pending.argument = argument;
        pending.value = value;
        self.count += 1;
        let restarts = match request.kind {
            Kind::RestartNode => {
                self.is_asked_to_restart |= argument != 0;
                argument != 0
            }
            kind => is(kind, Kind::BeginFirmwareUpdate) && Verdict::is_accepted(argument),
        };
        if restarts && !self.is_to_restart {
            self.is_to_restart = true;
            self.accepted_ms = now_ms;
        }
    }

    /// The oldest request waits for a save. Puts it behind all others, if others go first.
    pub fn postpone(&mut self, now_ms: u16) {
        // Between the answer and an update a status tells of it.
        if ANSWERS_WHILE_SAVING || update::IS_THERE {
            self.accepted_ms = now_ms;
        }
        if ANSWERS_WHILE_SAVING {
            let pending = *self.place(0);
            *self.place(self.count) = pending;
            self.first = (self.first + 1) % WAITING as u8;
        }
    }

    /// Removes the oldest request: the last frame of its response was handed over. Returns true if
    /// the program ends soon, maybe for an update: a status tells of that before.
    pub fn responded(&mut self) -> bool {
        self.count -= 1;
        self.first = (self.first + 1) % WAITING as u8;
        update::IS_THERE && self.is_to_restart
    }

    /// The program does not restart for an update after all.
    pub fn call_off_update(&mut self) {
        self.is_to_restart = self.is_asked_to_restart;
    }

    /// True if it is time to restart the program. `is_empty`: the controller has no frame to send.
    pub fn is_to_restart(&self, now_ms: u16, is_empty: bool) -> bool {
        let wait_ms = if is_empty && self.is_empty() { RESTART_MS } else { UNSENT_MS };
        self.is_to_restart && now_ms.wrapping_sub(self.accepted_ms) >= wait_ms
    }
}

/// True if a kind is `wanted`, which the build may leave out.
fn is(kind: Kind, wanted: Kind) -> bool {
    wanted != Kind::Unknown && kind == wanted
}
