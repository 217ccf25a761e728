//! Requests of clients, and the node's responses, one at a time and in order. The response to a
//! SAVE waits until the save is over; with the feature `save-answers` the others go first.

use dronecan_wire::Id;

use super::health::CanCounters;
use super::kind::Kind;
use super::outgoing::Form;
use super::parameters::Descriptions;
use super::wire::Transfer;
use super::{Node, Sending, information};
use crate::monitor::{Line, Monitor};
use crate::progmem::Progmem;

#[cfg(feature = "update")]
use super::update::Verdict;
#[cfg(feature = "standard")]
use super::{Chore, condition::Conditions, parameters, parameters::Parameters};
#[cfg(feature = "draft")]
use super::{dialect::Dialect, draft};

/// Requests that can wait for their response. A power of two. GUI tools send five at once.
const WAITING: usize = 8;

/// Time from the last frame of a RestartNode response to the restart, in milliseconds. In this time
/// the controller sends the frame, and the servo reaches its failsafe position.
const RESTART_MS: u16 = 100;

#[cfg(feature = "standard")]
const OPCODE_SAVE: u8 = 0;
#[cfg(feature = "standard")]
const OPCODE_ERASE: u8 = 1;

/// BeginFirmwareUpdate: ERROR_INVALID_MODE, the node cannot do it in this state.
#[cfg(all(feature = "standard", not(feature = "update")))]
const ERROR_INVALID_MODE: u8 = 1;

/// A response that waits to be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Reply {
    kind: Kind,
    to: u8,
    priority: u8,
    transfer_id: u8,
    /// GetSet: the index of the parameter. ExecuteOpcode, RestartNode: 1 if accepted, else 0.
    /// BeginFirmwareUpdate: the verdict.
    argument: u8,
    /// GetSet: the value after the request.
    value: u16,
}

impl Reply {
    const NONE: Self =
        Self { kind: Kind::Unknown, to: 0, priority: 0, transfer_id: 0, argument: 0, value: 0 };
}

/// The pending requests.
pub struct Services {
    /// A ring that starts at `first`.
    waiting: [Reply; WAITING],
    first: u8,
    count: u8,
    /// True while a response waits for the save that it has begun.
    #[cfg(feature = "standard")]
    is_saving: bool,
    /// True once the response to an accepted RestartNode was handed over.
    is_to_restart: bool,
    /// When to restart, in milliseconds. Valid if `is_to_restart`.
    restart_ms: u16,
}

impl Services {
    /// No pending requests.
    pub const fn new() -> Self {
        Self {
            waiting: [Reply::NONE; WAITING],
            first: 0,
            count: 0,
            #[cfg(feature = "standard")]
            is_saving: false,
            is_to_restart: false,
            restart_ms: 0,
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

    /// The response `behind` places after the oldest.
    #[inline(never)]
    fn place(&mut self, behind: u8) -> &mut Reply {
        &mut self.waiting[usize::from(self.first + behind) % WAITING]
    }

    /// Puts the oldest response behind all others.
    #[cfg(feature = "save-answers")]
    fn postpone(&mut self) {
        let reply = *self.place(0);
        *self.place(self.count) = reply;
        self.first = (self.first + 1) % WAITING as u8;
    }

    /// Removes the oldest response, whose last frame was handed over.
    pub fn replied(&mut self, now_ms: u16) {
        let &mut Reply { kind, argument, .. } = self.place(0);
        self.count -= 1;
        self.first = (self.first + 1) % WAITING as u8;
        #[cfg(feature = "update")]
        let is_update = kind == Kind::BeginFirmwareUpdate && argument == Verdict::Accepted as u8;
        #[cfg(not(feature = "update"))]
        let is_update = false;
        if (kind == Kind::RestartNode && argument != 0 || is_update) && !self.is_to_restart {
            self.is_to_restart = true;
            self.restart_ms = now_ms.wrapping_add(RESTART_MS);
        }
    }

    /// True if it is time to restart the program.
    #[inline(always)]
    pub fn is_to_restart(&self, now_ms: u16) -> bool {
        self.is_to_restart && now_ms.wrapping_sub(self.restart_ms) < 1 << 15
    }
}

impl Default for Services {
    fn default() -> Self {
        Self::new()
    }
}

impl Node {
    /// Acts on a request and queues its response. Returns the line to log.
    #[inline(always)]
    pub(super) fn serve(
        &mut self,
        request: &Transfer,
        now_ms: u16,
        flash: impl Progmem<Descriptions>,
    ) -> Line {
        #[allow(unused_mut, reason = "a build may have no other line")]
        let mut line = Line::Request;
        let mut argument = 0;
        #[allow(unused_mut, reason = "a build may have no parameters over the bus")]
        let mut value = 0;
        match request.kind {
            #[cfg(feature = "standard")]
            Kind::GetSet => {
                let Some(get_set) = GetSet::read(request, flash) else {
                    return Line::RefusedLength;
                };
                if let Some(value) = get_set.value {
                    if self.parameters.set(get_set.parameter, value, flash) {
                        line = Line::ParameterSet;
                        self.chores.add(Chore::TakeParameters);
                    } else if get_set.parameter < parameters::COUNT as u8 {
                        line = Line::ParameterRejected;
                        #[cfg(feature = "outputs")]
                        if self.parameters.has_no_room(get_set.parameter, value as u16) {
                            line = Line::ParameterNoRoom;
                        }
                    }
                    self.note.a = value as u16;
                    self.note.b = u16::from(get_set.parameter);
                }
                argument = get_set.parameter;
                value = self.parameters.value(get_set.parameter).unwrap_or(0);
            }
            #[cfg(feature = "standard")]
            Kind::ExecuteOpcode => {
                let &[opcode, ..] = request.bytes();
                if request.len() != 7 {
                    return Line::RefusedLength;
                }
                if opcode == OPCODE_ERASE {
                    self.parameters.set_defaults(flash);
                    self.chores.add(Chore::TakeParameters);
                }
                argument = u8::from(opcode == OPCODE_SAVE || opcode == OPCODE_ERASE);
            }
            #[cfg(feature = "update")]
            Kind::BeginFirmwareUpdate => {
                let verdict = self.begin_update(request, now_ms);
                argument = verdict as u8;
                if verdict == Verdict::Accepted {
                    self.actuators.fail_safe(&self.parameters);
                }
            }
            // The magic number is 0xACCE551B1E (DSDL 5.RestartNode.uavcan).
            Kind::RestartNode
                if request.len() == 5
                    && matches!(request.bytes(), [0x1E, 0x1B, 0x55, 0xCE, 0xAC, ..]) =>
            {
                argument = 1;
                self.actuators.fail_safe(&self.parameters);
            }
            _ => {}
        }
        let _ = (now_ms, flash);
        let services = &mut self.services;
        let reply = services.place(services.count);
        reply.kind = request.kind;
        reply.to = request.source;
        reply.priority = request.priority;
        reply.transfer_id = request.transfer_id();
        reply.argument = argument;
        reply.value = value;
        services.count += 1;
        line
    }

    /// Begins the response to the oldest request. Returns false if there is none, or if it waits
    /// for a save.
    pub(super) fn begin_reply(
        &mut self,
        counters: &impl CanCounters,
        flash: impl Progmem<Descriptions>,
        monitor: &mut Monitor,
    ) -> bool {
        if self.services.is_empty() {
            return false;
        }
        let reply = *self.services.place(0);
        #[cfg(feature = "draft")]
        let is_draft = Dialect::is_of_draft(reply.priority);
        #[cfg(not(feature = "draft"))]
        let is_draft = false;
        self.outgoing.clear(is_draft);
        match reply.kind {
            Kind::GetNodeInfo => {
                if is_draft {
                    self.outgoing.put8(0);
                }
                self.put_status();
                self.outgoing.payload.form = Form::NodeInfo;
                self.outgoing.payload.len = information::NODE_INFO_LEN;
            }
            #[cfg(feature = "stats")]
            Kind::GetTransportStats => {
                use mcp2515_ordered::Counter;
                self.outgoing.put16(self.health.transfers.sent);
                self.outgoing.put16(self.health.transfers.received);
                self.outgoing.put16(self.health.transfers.broken);
                for counter in [Counter::TxRequests, Counter::RxReceived, Counter::RxErrors] {
                    self.outgoing.put16(counters.word(counter as u8));
                }
                self.outgoing.payload.form = Form::Numbers48;
                self.outgoing.payload.len = 36;
            }
            #[cfg(feature = "standard")]
            Kind::GetSet if reply.argument >= parameters::COUNT as u8 => {
                // No such parameter: four empty values and an empty name.
                self.outgoing.put16(0);
                self.outgoing.put16(0);
            }
            #[cfg(feature = "standard")]
            Kind::GetSet => {
                let name_at = parameters::name_at(reply.argument, flash);
                self.outgoing.payload.form = Form::Parameter;
                self.outgoing.payload.parameter = (reply.argument, reply.value, name_at);
                self.outgoing.payload.len = parameters::NUMBERS_LEN + flash.byte(name_at - 1);
            }
            // A restart would cut off the save, to which the response comes later.
            #[cfg(all(feature = "save-answers", feature = "update"))]
            Kind::BeginFirmwareUpdate if self.store.is_saving() => {
                self.services.postpone();
                return false;
            }
            #[cfg(feature = "update")]
            Kind::BeginFirmwareUpdate => {
                let (error, text_at, text_len) = Verdict::from_number(reply.argument).response();
                self.outgoing.put8(error);
                self.outgoing.payload.form = Form::Text;
                self.outgoing.payload.text_at = text_at;
                self.outgoing.payload.len = 1 + text_len;
            }
            #[cfg(all(feature = "standard", not(feature = "update")))]
            Kind::BeginFirmwareUpdate => {
                self.outgoing.put8(ERROR_INVALID_MODE);
                self.outgoing.payload.form = Form::Text;
                self.outgoing.payload.len = 1 + information::NO_UPDATE_LEN;
            }
            #[cfg(feature = "standard")]
            Kind::ExecuteOpcode => {
                let mut is_done = reply.argument != 0;
                if is_done {
                    if !self.services.is_saving {
                        self.services.is_saving = true;
                        self.store.save();
                    }
                    if self.store.is_saving() {
                        #[cfg(feature = "save-answers")]
                        self.services.postpone();
                        return false;
                    }
                    is_done = self.store.is_saved();
                    if is_done {
                        self.health.clear(Conditions::PARAMETERS_LOST);
                    }
                    self.services.is_saving = false;
                    monitor.log_line(if is_done { Line::Saved } else { Line::NotSaved });
                }
                for byte in [0, 0, 0, 0, 0, 0, u8::from(is_done) << 7] {
                    self.outgoing.put8(byte);
                }
            }
            // A restart would cut off the save, to which the response comes later.
            #[cfg(feature = "save-answers")]
            Kind::RestartNode if self.store.is_saving() => {
                self.services.postpone();
                return false;
            }
            _ => self.outgoing.put8(reply.argument << 7),
        }
        let _ = (counters, flash, monitor);
        self.sending = Sending::Reply;
        #[cfg(feature = "draft")]
        if is_draft {
            let is_info = reply.kind == Kind::GetNodeInfo;
            self.outgoing.reply_to(reply.to);
            let upper = if is_info { draft::sent::NODE_INFO } else { draft::sent::RESTARTED };
            self.outgoing.begin(
                draft::id(upper, self.id),
                reply.transfer_id,
                draft::NODE_INFO_SEED,
            );
            return true;
        }
        let id = Id::response(reply.priority, reply.kind.id() as u8, reply.to, self.id);
        self.outgoing.begin(id.to_bytes(), reply.transfer_id, reply.kind.seed());
        true
    }
}

/// A decoded GetSet request.
#[cfg(feature = "standard")]
struct GetSet {
    /// The index of the parameter; [`parameters::NONE`] if the name is unknown or the index does
    /// not fit in eight bits.
    parameter: u8,
    /// The value to set. `None` if the request has no integer, or one that does not fit in 32
    /// bits.
    value: Option<i32>,
}

#[cfg(feature = "standard")]
impl GetSet {
    /// Reads a request (DSDL 11.GetSet.uavcan): 13 bits of index, 3 of tag, the value, the name.
    /// Returns `None` if it is too short.
    #[inline(always)]
    fn read(request: &Transfer, flash: impl Progmem<Descriptions>) -> Option<Self> {
        const INTEGER: u8 = 1;
        let &[index, index_and_tag, v0, v1, v2, v3, v4, v5, v6, v7, ..] = request.bytes();
        let tag = index_and_tag & 7;
        let value_len = match tag {
            0 => 0,
            INTEGER => 8,
            2 => 4,
            3 => 1,
            _ => v0.saturating_add(1),
        };
        let name_at = value_len.saturating_add(2);
        if name_at > request.len() {
            return None;
        }
        let mut parameter = if index_and_tag >> 3 == 0 { index } else { parameters::NONE };
        if name_at != request.len() {
            let name = request.payload().get(usize::from(name_at)..);
            parameter = name.map_or(parameters::NONE, |name| Parameters::find(name, flash));
        }
        let number = i32::from_le_bytes([v0, v1, v2, v3]);
        // The upper four bytes may only repeat the sign.
        let sign = (v3 as i8 >> 7) as u8;
        let is_number = tag == INTEGER && v4 == sign && v5 == sign && v6 == sign && v7 == sign;
        Some(Self { parameter, value: is_number.then_some(number) })
    }
}
