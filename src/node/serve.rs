//! Requests of those who manage the node, and its replies, one at a time and in order.

use super::outgoing::Form;
use super::parameters::{self, Parameters};
use super::{CHORE_PARAMETERS, Node, condition::Conditions, information};
use crate::can::mcp2515::{Counted, Counters};
use crate::dronecan::draft;
use crate::dronecan::kind::Kind;
use crate::dronecan::receive::Transfer;
use crate::dronecan::wire::SERVICE_NOT_MESSAGE;
use crate::monitor::{Event, Line, Monitor};
use crate::progmem::Progmem;

/// Requests that can wait for their reply: GUI tools send five at once. A power of two.
const WAITING: usize = 8;

const OPCODE_SAVE: u8 = 0;
const OPCODE_ERASE: u8 = 1;

/// BeginFirmwareUpdate: not in this state.
const ERROR_INVALID_MODE: u8 = 1;

/// GetSet: the tag of an integer.
const INTEGER: u8 = 1;

/// Makes a GetSet request by name one by index, which takes as long as all else with it. Whether it was one by name.
#[inline(always)]
pub(super) fn look_up(transfer: &mut Transfer, flash: impl Progmem) -> bool {
    let [_, tag, b2, ..] = transfer.bytes;
    let tag = tag & 7;
    let value_len = match tag {
        0 => 0,
        INTEGER => 8,
        2 => 4,
        3 => 1,
        _ => b2.saturating_add(1),
    };
    let name_at = value_len.saturating_add(2);
    if name_at >= transfer.len {
        return false;
    }
    // A name that is longer than any is none.
    let name = transfer.bytes.get(usize::from(name_at)..usize::from(transfer.len));
    let index = name.map_or(parameters::NONE, |name| Parameters::find(name, flash));
    [transfer.bytes[0], transfer.bytes[1]] = [index, tag];
    transfer.len = name_at;
    true
}

/// A reply to be. Eight bytes, so that its place is found by shifting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Reply {
    kind: Kind,
    to: u8,
    priority: u8,
    transfer_id: u8,
    /// GetSet: the parameter. ExecuteOpcode, RestartNode: whether it is done.
    argument: u8,
    /// GetSet: the value then in force.
    value: u16,
    spare: u8,
}

/// Replies that wait, oldest first, in a ring.
pub struct Replies {
    waiting: [Reply; WAITING],
    first: u8,
    count: u8,
    is_saving: bool,
}

impl Replies {
    /// Nobody waits.
    pub const fn new() -> Self {
        let none =
            Reply { kind: Kind::ARRAY_COMMAND, to: 0, priority: 0, transfer_id: 0, argument: 0, value: 0, spare: 0 };
        Self { waiting: [none; WAITING], first: 0, count: 0, is_saving: false }
    }

    /// Whether no more can wait.
    #[inline(always)]
    pub fn is_full(&self) -> bool {
        self.count == WAITING as u8
    }

    /// Whether nobody waits.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The place of the reply that is so many behind the oldest.
    fn place(&mut self, behind: u8) -> &mut Reply {
        &mut self.waiting[usize::from(self.first.wrapping_add(behind)) % WAITING]
    }

    /// The first reply has left. Whether it was the answer to a request to restart.
    pub fn pop(&mut self) -> bool {
        let &mut Reply { kind, argument, .. } = self.place(0);
        self.count = self.count.wrapping_sub(1);
        self.first = self.first.wrapping_add(1);
        kind == Kind::RESTART_NODE && argument != 0
    }
}

impl Node {
    /// Acts on a request and makes a note to reply. The line that tells of it.
    #[inline(never)]
    pub(super) fn serve(&mut self, transfer: &Transfer, event: &mut Event, flash: impl Progmem) -> Line {
        let mut line = Line::Request;
        let mut argument = 0;
        event.a = transfer.kind.id(flash);
        if self.replies.is_full() {
            return Line::RefusedBusy;
        }
        match transfer.kind {
            Kind::GET_SET => {
                if transfer.len < 2 {
                    return Line::RefusedLength;
                }
                argument = self.get_set(transfer, event, flash, &mut line);
            }
            Kind::EXECUTE_OPCODE => {
                let [opcode, ..] = transfer.bytes;
                if transfer.len != 7 {
                    return Line::RefusedLength;
                }
                if opcode == OPCODE_ERASE {
                    self.parameters.set_defaults(flash);
                    self.chores |= CHORE_PARAMETERS;
                }
                argument = u8::from(opcode == OPCODE_SAVE || opcode == OPCODE_ERASE);
            }
            Kind::RESTART_NODE => {
                // 0xACCE551B1E, 40 bits (DSDL 5.RestartNode.uavcan).
                let at = u8::from(transfer.priority & draft::DRAFT != 0);
                let is_magic = transfer.word(at) == 0x1B1E
                    && transfer.word(at.wrapping_add(2)) == 0xCE55
                    && transfer.word(at.wrapping_add(4)) as u8 == 0xAC;
                if is_magic && transfer.len == at.wrapping_add(5) {
                    argument = 1;
                    self.fail_safe();
                }
            }
            _ => {}
        }
        let value = self.parameters.value(argument).unwrap_or(0);
        let reply = self.replies.place(self.replies.count);
        reply.kind = transfer.kind;
        reply.to = transfer.source;
        reply.priority = transfer.priority;
        reply.transfer_id = transfer.transfer_id();
        reply.argument = argument;
        reply.value = value;
        self.replies.count = self.replies.count.wrapping_add(1);
        line
    }

    /// Sets what is asked for; which parameter it is.
    #[inline(always)]
    fn get_set(&mut self, transfer: &Transfer, event: &mut Event, flash: impl Progmem, line: &mut Line) -> u8 {
        let [index, index_and_tag, ..] = transfer.bytes;
        let parameter = if index_and_tag >> 3 == 0 { index } else { parameters::NONE };
        // Of an integer there are eight bytes after the index.
        if index_and_tag & 7 == INTEGER && transfer.len >= 10 {
            let (low, high) = (transfer.word(2), transfer.word(4));
            // The upper half may only repeat the sign.
            let sign = ((high as i16) >> 15) as u16;
            if transfer.word(6) == sign && transfer.word(8) == sign && self.parameters.set(parameter, low, high, flash)
            {
                *line = Line::ParameterSet;
                self.chores |= CHORE_PARAMETERS;
                event.a = low;
                event.b = u16::from(parameter);
            }
        }
        parameter
    }

    /// Begins the reply to the request that has waited longest, if it is done.
    #[inline(never)]
    pub(super) fn begin_reply(&mut self, counters: &impl Counted, flash: impl Progmem, monitor: &mut Monitor) -> bool {
        if self.replies.is_empty() {
            return false;
        }
        let reply = *self.replies.place(0);
        let is_draft = reply.priority & draft::DRAFT != 0;
        self.outgoing.clear(is_draft);
        match reply.kind {
            Kind::GET_NODE_INFO => {
                if is_draft {
                    self.outgoing.put8(0);
                }
                self.put_status();
                self.outgoing.form = Form::NodeInfo;
                self.outgoing.len = 7 + information::VERSIONS_LEN + 16 + 1 + information::NAME.len() as u8;
            }
            Kind::GET_TRANSPORT_STATS => {
                self.outgoing.put16(self.counts.sent);
                self.outgoing.put16(self.counts.received);
                self.outgoing.put16(self.counts.broken);
                self.outgoing.put16(counters.word(Counters::TX_REQUESTS as u8));
                self.outgoing.put16(counters.word(Counters::RX_RECEIVED as u8));
                self.outgoing.put16(counters.word(Counters::RX_ERRORS as u8));
                self.outgoing.form = Form::Numbers48;
                self.outgoing.len = 36;
            }
            Kind::GET_SET => {
                if reply.argument >= parameters::COUNT as u8 {
                    // No such parameter: four empty values and no name.
                    self.outgoing.put16(0);
                    self.outgoing.put16(0);
                } else {
                    self.outgoing.form = Form::Parameter;
                    self.outgoing.parameter = reply.argument;
                    self.outgoing.value = reply.value;
                    self.outgoing.name_at = parameters::name_at(reply.argument, flash);
                    self.outgoing.len =
                        flash.byte(self.outgoing.name_at.wrapping_sub(1)).wrapping_add(parameters::NUMBERS_LEN);
                }
            }
            Kind::BEGIN_FIRMWARE_UPDATE => {
                self.outgoing.put8(ERROR_INVALID_MODE);
                self.outgoing.form = Form::Text;
                self.outgoing.len = 1 + information::NO_UPDATE_LEN;
            }
            Kind::EXECUTE_OPCODE => {
                let mut is_done = reply.argument != 0;
                if is_done {
                    if !self.replies.is_saving {
                        self.replies.is_saving = true;
                        self.store.save();
                    }
                    if self.store.is_saving() {
                        return false;
                    }
                    is_done = self.store.is_saved();
                    if is_done {
                        self.conditions.set(Conditions::PARAMETERS_LOST, false);
                    }
                    self.replies.is_saving = false;
                    monitor.tell(if is_done { Line::Saved } else { Line::NotSaved });
                }
                self.outgoing.put16(0);
                self.outgoing.put16(0);
                self.outgoing.put16(0);
                self.outgoing.put8(u8::from(is_done) << 7);
            }
            _ => {
                self.outgoing.put8(reply.argument << 7);
            }
        }
        let mut seed = reply.kind.seed(flash);
        self.outgoing.frame.id = [reply.priority, reply.kind.id_low(flash), reply.to, SERVICE_NOT_MESSAGE | self.id];
        if is_draft {
            let is_info = reply.kind == Kind::GET_NODE_INFO;
            self.outgoing.address(if is_info { draft::NODE_INFO } else { draft::RESTARTED }, self.id);
            self.outgoing.reply_to(reply.to);
            seed = draft::NODE_INFO_SEED;
        }
        self.outgoing.begin(reply.transfer_id, seed);
        true
    }
}
