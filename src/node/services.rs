//! Requests of clients, and the node's responses, one at a time and in order. The response to a
//! SAVE waits until the save is over; with the feature `save-answers` the others go first.

use dronecan_wire::Id;

use super::Node;
use super::get_set::GetSet;
use super::outgoing::{Form, Sending};
use super::receive::Context;
use crate::hardware::CanCounters;
use crate::hardware::OUTPUTS;
use crate::monitor::{Line, Monitor};
use crate::parts::stats;
use crate::parts::update::{HAS_TEXTS, Verdict};
use crate::tables::condition::Conditions;
use crate::tables::kind::Kind;
use crate::tables::parameters;
use crate::tables::wire::Transfer;
use crate::tables::{Constants, information};

/// Requests that can wait for their response. A power of two. GUI tools send five at once.
const WAITING: usize = 8;

/// Time from the hand-over of a RestartNode response to the restart, in milliseconds. In this time
/// the servo reaches its failsafe position.
const RESTART_MS: u16 = 100;

/// The same if the controller has not sent all frames until then, because the bus is full.
const UNSENT_MS: u16 = 1000;

/// True if other responses go before the one that waits for a save.
const ANSWERS_WHILE_SAVING: bool = cfg!(feature = "save-answers");

/// ExecuteOpcode.opcode (DSDL uavcan/protocol/param/10.ExecuteOpcode.uavcan).
const OPCODE_SAVE: u8 = 0;
/// The same.
const OPCODE_ERASE: u8 = 1;

/// Errors of BeginFirmwareUpdate (DSDL uavcan/protocol/file/40.BeginFirmwareUpdate.uavcan).
const ERROR_OK: u8 = 0;
/// The node cannot do it in this state.
const ERROR_INVALID_MODE: u8 = 1;

/// A request that waits for its response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pending {
    /// The service.
    pub kind: Kind,
    to: u8,
    priority: u8,
    transfer_id: u8,
    /// GetSet: the index of the parameter. ExecuteOpcode, RestartNode: 1 if accepted, else 0.
    /// BeginFirmwareUpdate: the verdict.
    argument: u8,
    /// GetSet: the value after the request.
    value: u16,
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
    #[inline(always)]
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
    /// True while a response waits for the save that it has begun.
    is_saving: bool,
    /// True once the response to an accepted RestartNode was handed over.
    is_to_restart: bool,
    /// When that was, in milliseconds. Valid if `is_to_restart`.
    responded_ms: u16,
}

impl Services {
    /// No pending requests.
    pub const fn new() -> Self {
        Self {
            waiting: [Pending::NONE; WAITING],
            first: 0,
            count: 0,
            is_saving: false,
            is_to_restart: false,
            responded_ms: 0,
        }
    }

    /// True if the queue has no room for another request.
    #[inline(always)]
    pub fn is_full(&self) -> bool {
        self.count == WAITING as u8
    }

    /// True if no request is pending.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The request `behind` places after the oldest.
    #[inline(never)]
    fn place(&mut self, behind: u8) -> &mut Pending {
        &mut self.waiting[usize::from(self.first + behind) % WAITING]
    }

    /// Adds a request. There must be room. `argument` and `value` are those of its response.
    #[inline(always)]
    pub fn add(&mut self, request: &Transfer, argument: u8, value: u16) {
        let pending = self.place(self.count);
        pending.kind = request.kind;
        pending.to = request.source;
        pending.priority = request.priority;
        pending.transfer_id = request.transfer_id();
        pending.argument = argument;
        pending.value = value;
        self.count += 1;
    }

    /// Puts the oldest request behind all others, if others go first.
    #[inline(always)]
    fn postpone(&mut self) {
        if ANSWERS_WHILE_SAVING {
            let pending = *self.place(0);
            *self.place(self.count) = pending;
            self.first = (self.first + 1) % WAITING as u8;
        }
    }

    /// Removes the oldest request: the last frame of its response was handed over.
    #[inline(always)]
    pub fn responded(&mut self, now_ms: u16) {
        let &mut Pending { kind, argument, .. } = self.place(0);
        self.count -= 1;
        self.first = (self.first + 1) % WAITING as u8;
        let restarts = match kind {
            Kind::RestartNode => argument != 0,
            kind => is(kind, Kind::BeginFirmwareUpdate) && Verdict::is_accepted(argument),
        };
        if restarts && !self.is_to_restart {
            self.is_to_restart = true;
            self.responded_ms = now_ms;
        }
    }

    /// The program does not restart after all.
    #[inline(always)]
    pub fn call_off_restart(&mut self) {
        self.is_to_restart = false;
    }

    /// True if it is time to restart the program. `is_empty`: the controller has no frame to send.
    #[inline(always)]
    pub fn is_to_restart(&self, now_ms: u16, is_empty: bool) -> bool {
        let wait_ms = if is_empty { RESTART_MS } else { UNSENT_MS };
        self.is_to_restart && now_ms.wrapping_sub(self.responded_ms) >= wait_ms
    }
}

/// True if a kind is `wanted`, which the build may leave out.
#[inline(always)]
fn is(kind: Kind, wanted: Kind) -> bool {
    wanted != Kind::Unknown && kind == wanted
}

impl Default for Services {
    fn default() -> Self {
        Self::new()
    }
}

impl Node {
    /// Begins the response to the oldest request. Returns false if there is none, or if it waits
    /// for a save.
    #[inline(always)]
    pub(super) fn begin_response<C: CanCounters, P: Constants>(
        &mut self,
        context: &mut Response<C, P>,
    ) -> bool {
        if self.services.is_empty() {
            return false;
        }
        let pending = *self.services.place(0);
        self.outgoing.clear();
        if !self.respond(&pending, context) {
            return false;
        }
        self.sending = Sending::Response;
        let Pending { kind, to, priority, transfer_id, .. } = pending;
        let id = Id::response(priority, kind.data_type(context.flash) as u8, to, self.id);
        self.outgoing.begin(id.to_bytes(), transfer_id, kind.seed());
        true
    }
}

/// The actions on requests, and the responses, which the table of received types names. An action
/// returns the line to log. Unless that is a refusal, the request is queued for its response. A
/// response returns false if it has to wait.
#[allow(dead_code, reason = "a build may leave out the row that names one")]
impl Node {
    /// Accepts a request that needs no action.
    #[inline(always)]
    pub(super) fn accept<P>(&mut self, _: &Transfer, _: &mut Context<P>) -> Reply {
        Reply::of(Line::Request)
    }

    #[inline(always)]
    pub(super) fn respond_node_info<C, P>(
        &mut self,
        _: &Pending,
        context: &mut Response<C, P>,
    ) -> bool {
        self.put_status(context.now_ms);
        self.outgoing.payload.form = Form::NodeInfo;
        self.outgoing.payload.len = information::NODE_INFO_LEN;
        true
    }

    #[inline(always)]
    pub(super) fn respond_stats<C: CanCounters, P>(
        &mut self,
        _: &Pending,
        context: &mut Response<C, P>,
    ) -> bool {
        self.stats.put_transport(context.counters, |number| self.outgoing.put32(number));
        self.outgoing.payload.form = Form::Numbers48;
        self.outgoing.payload.len = stats::LEN;
        true
    }

    #[inline(always)]
    pub(super) fn act_on_restart<P>(&mut self, request: &Transfer, _: &mut Context<P>) -> Reply {
        // The magic number is 0xACCE551B1E (DSDL uavcan/protocol/5.RestartNode.uavcan).
        let is_accepted =
            request.len() == 5 && matches!(request.bytes(), [0x1E, 0x1B, 0x55, 0xCE, 0xAC, ..]);
        if is_accepted {
            self.outputs.fail_safe(&self.parameters);
        }
        Reply { argument: is_accepted.into(), ..Reply::of(Line::Request) }
    }

    /// The response to RestartNode: one bit.
    #[inline(always)]
    pub(super) fn respond_ok<C, P>(&mut self, pending: &Pending, _: &mut Response<C, P>) -> bool {
        // A restart would cut off the save, to which the response comes later.
        if ANSWERS_WHILE_SAVING && self.store.is_saving() {
            self.services.postpone();
            return false;
        }
        self.outgoing.put8(pending.argument << 7);
        true
    }

    /// True if type, ID and number of the outputs must not change, because the vehicle is armed: a
    /// motor would stop. A single output is no motor.
    #[inline(always)]
    fn are_outputs_fixed(&self) -> bool {
        OUTPUTS > 1 && self.outputs.arming.is_armed()
    }

    #[inline(always)]
    pub(super) fn act_on_get_set<P: Constants>(
        &mut self,
        request: &Transfer,
        context: &mut Context<P>,
    ) -> Reply {
        let flash = context.flash;
        let Some(GetSet { parameter, value }) = GetSet::read(request, flash) else {
            return Reply::of(Line::RefusedLength);
        };
        let mut line = Line::Request;
        if let Some(value) = value {
            let is_fixed = self.are_outputs_fixed()
                && parameters::is_of_outputs(parameter)
                && self.parameters.value(parameter) != Some(value as u16);
            if !is_fixed && self.parameters.set(parameter, value, flash) {
                line = Line::ParameterSet;
                self.apply_parameters();
            } else if parameter < parameters::COUNT as u8 {
                line = Line::ParameterRejected;
                if self.parameters.has_no_room(parameter, value as u16) {
                    line = Line::ParameterNoRoom;
                }
            }
            self.note.set_a(value as u16);
            self.note.set_b(u16::from(parameter));
        }
        Reply { line, argument: parameter, value: self.parameters.value(parameter).unwrap_or(0) }
    }

    #[inline(always)]
    pub(super) fn respond_get_set<C, P: Constants>(
        &mut self,
        pending: &Pending,
        context: &mut Response<C, P>,
    ) -> bool {
        if pending.argument >= parameters::COUNT as u8 {
            // No such parameter: four empty values and an empty name.
            self.outgoing.put_zeros(4);
            return true;
        }
        let payload = &mut self.outgoing.payload;
        payload.form = Form::Parameter;
        (payload.parameter, payload.len) =
            parameters::Response::new(pending.argument, pending.value, context.flash);
        true
    }

    #[inline(always)]
    pub(super) fn act_on_opcode<P: Constants>(
        &mut self,
        request: &Transfer,
        context: &mut Context<P>,
    ) -> Reply {
        let &[opcode, ..] = request.bytes();
        if request.len() != 7 {
            return Reply::of(Line::RefusedLength);
        }
        let erases = opcode == OPCODE_ERASE && !self.are_outputs_fixed();
        if erases {
            self.parameters.set_defaults(context.flash);
            self.apply_parameters();
        }
        let is_done = opcode == OPCODE_SAVE || erases;
        Reply { argument: is_done.into(), ..Reply::of(Line::Request) }
    }

    #[inline(always)]
    pub(super) fn respond_opcode<C, P>(
        &mut self,
        pending: &Pending,
        context: &mut Response<C, P>,
    ) -> bool {
        let mut is_done = pending.argument != 0;
        if is_done {
            if !self.services.is_saving {
                self.services.is_saving = true;
                self.store.save();
            }
            if self.store.is_saving() {
                self.services.postpone();
                return false;
            }
            is_done = self.store.is_saved();
            if is_done {
                self.health.clear(Conditions::PARAMETERS_LOST);
                self.update.parameters_are_saved();
            }
            self.services.is_saving = false;
            context.monitor.log_line(if is_done { Line::Saved } else { Line::NotSaved });
        }
        // 48 bits of the argument, then one bit.
        self.outgoing.put_zeros(6);
        self.outgoing.put8(u8::from(is_done) << 7);
        true
    }

    #[inline(always)]
    pub(super) fn act_on_update<P>(&mut self, request: &Transfer, _: &mut Context<P>) -> Reply {
        let verdict = self.update.act_on_request(request, self.outputs.are_in_use()) as u8;
        if Verdict::is_accepted(verdict) {
            self.outputs.fail_safe(&self.parameters);
        }
        Reply { argument: verdict, ..Reply::of(Line::Request) }
    }

    #[inline(always)]
    pub(super) fn respond_update<C, P>(
        &mut self,
        pending: &Pending,
        _: &mut Response<C, P>,
    ) -> bool {
        // A restart would cut off the save, to which the response comes later.
        if ANSWERS_WHILE_SAVING && self.store.is_saving() {
            self.services.postpone();
            return false;
        }
        let is_accepted = Verdict::is_accepted(pending.argument);
        self.outgoing.put8(if is_accepted { ERROR_OK } else { ERROR_INVALID_MODE });
        if !HAS_TEXTS {
            return true;
        }
        let (text_at, text_len) = Verdict::text(pending.argument);
        self.outgoing.payload.form = Form::Text;
        self.outgoing.payload.text_at = text_at;
        self.outgoing.payload.len = 1 + text_len;
        true
    }
}
