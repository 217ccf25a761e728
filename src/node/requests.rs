//! What the node does at a request, and what its response has.

use super::Node;
use super::get_set::GetSet;
use super::outgoing::Form;
use super::services::{ANSWERS_WHILE_SAVING, Pending, Reply, Response};
use crate::hardware::{CanCounters, OUTPUTS};
use crate::monitor::{self, Line, Words};
use crate::parts::update::{self, HAS_TEXTS, Verdict};
use crate::tables::condition::Conditions;
use crate::tables::parameters::Conflict;
use crate::tables::wire::Transfer;
use crate::tables::{Constants, information, parameters};

/// ExecuteOpcode.opcode (DSDL uavcan/protocol/param/10.ExecuteOpcode.uavcan).
const OPCODE_SAVE: u8 = 0;
/// The same.
const OPCODE_ERASE: u8 = 1;

/// Errors of BeginFirmwareUpdate (DSDL uavcan/protocol/file/40.BeginFirmwareUpdate.uavcan).
const ERROR_OK: u8 = 0;
/// The node cannot do it in this state.
const ERROR_INVALID_MODE: u8 = 1;

/// The actions on requests, and the responses, which the table of received types names. An action
/// returns the line to log. Unless that is a refusal, the request is queued for its response. A
/// response returns false if it has to wait.
#[allow(dead_code, reason = "a build may leave out the row that names one")]
impl Node {
    /// Accepts a request that needs no action.
    pub(super) fn accept(&mut self, _: &Transfer, _: impl Constants) -> Reply {
        Reply::of(Line::Request)
    }

    pub(super) fn respond_node_info<C, P>(
        &mut self,
        _: &Pending,
        context: &mut Response<C, P>,
    ) -> bool {
        self.put_status(context.now_ms);
        if update::IS_THERE {
            self.transmission.outgoing.put8(self.update.mark());
        }
        self.transmission.outgoing.payload.form = Form::NodeInfo;
        self.transmission.outgoing.payload.len = information::NODE_INFO_LEN;
        true
    }

    pub(super) fn respond_stats<C: CanCounters, P>(
        &mut self,
        _: &Pending,
        context: &mut Response<C, P>,
    ) -> bool {
        let outgoing = &mut self.transmission.outgoing;
        self.record.stats.put_transport(context.counters, |low, high| outgoing.put48(low, high));
        true
    }

    pub(super) fn act_on_restart(&mut self, request: &Transfer, _: impl Constants) -> Reply {
        // The magic number is 0xACCE551B1E (DSDL uavcan/protocol/5.RestartNode.uavcan).
        let is_accepted =
            request.len() == 5 && matches!(request.bytes(), [0x1E, 0x1B, 0x55, 0xCE, 0xAC, ..]);
        if is_accepted {
            self.control.outputs.fail_safe(&self.parameters);
        }
        Reply { argument: is_accepted.into(), ..Reply::of(Line::Request) }
    }

    /// The response to RestartNode: one bit.
    pub(super) fn respond_ok<C, P>(
        &mut self,
        pending: &Pending,
        context: &mut Response<C, P>,
    ) -> bool {
        // A restart would cut off the save, to which the response comes later.
        if ANSWERS_WHILE_SAVING && self.store.is_saving() {
            self.transmission.services.postpone(context.now_ms);
            return false;
        }
        self.transmission.outgoing.put8(pending.argument << 7);
        true
    }

    /// True if type, ID and number of the outputs must not change, because the vehicle is armed: a
    /// motor would stop. A single output is no motor.
    fn are_outputs_fixed(&self) -> bool {
        OUTPUTS > 1 && self.control.outputs.arming.is_armed()
    }

    /// Notes the number that a parameter is set to. An event has 16 bits of it and a word: for its
    /// sign, or for the thousands of a bit rate, which is the only larger number.
    fn note_number(&mut self, value: i32) {
        if !monitor::IS_THERE {
            return;
        }
        let mut number = value as u16;
        let mut high = (value >> 16) as u8;
        let mut word = Words::NUMBER.number(0);
        if (high as i8) < 0 {
            word = Words::NUMBER.number(1);
        } else if high != 0 {
            word = Words::NUMBER.number(2);
            // 1, 3, 7 and 15 are the upper bits of 125,000, doubled up to three times.
            number = 125;
            while high != 1 {
                high >>= 1;
                number <<= 1;
            }
        }
        self.record.note.set_code(word);
        self.record.note.set_a(number);
    }

    pub(super) fn act_on_get_set(&mut self, request: &Transfer, flash: impl Constants) -> Reply {
        let Some(GetSet { parameter, value }) = GetSet::read(request, flash) else {
            return Reply::of(Line::RefusedLength);
        };
        let mut line = Line::Request;
        if let Some(value) = value {
            self.note_number(value);
            self.record.note.set_b(u16::from(parameter));
            let is_fixed = self.are_outputs_fixed()
                && parameters::is_of_outputs(parameter)
                && self.parameters.value(parameter) != Some(value as u16);
            if !is_fixed && self.parameters.set(parameter, value, flash) {
                line = Line::ParameterSet;
                self.apply_parameters();
            } else if parameter < parameters::COUNT as u8 {
                line = match self.parameters.conflict(parameter, value as u16) {
                    None => Line::ParameterRejected,
                    Some(Conflict::NoRoom) => Line::ParameterNoRoom,
                    Some(Conflict::Servo) => Line::ParameterOfMotors,
                };
            }
        }
        Reply { line, argument: parameter, value: self.parameters.value(parameter).unwrap_or(0) }
    }

    pub(super) fn respond_get_set<C, P: Constants>(
        &mut self,
        pending: &Pending,
        context: &mut Response<C, P>,
    ) -> bool {
        if pending.argument >= parameters::COUNT as u8 {
            // No such parameter: four empty values and an empty name.
            self.transmission.outgoing.put_zeros(4);
            return true;
        }
        let payload = &mut self.transmission.outgoing.payload;
        payload.form = Form::Parameter;
        (payload.parameter, payload.len) =
            parameters::Response::new(pending.argument, pending.value, context.flash);
        true
    }

    pub(super) fn act_on_opcode(&mut self, request: &Transfer, flash: impl Constants) -> Reply {
        let &[opcode, ..] = request.bytes();
        if request.len() != 7 {
            return Reply::of(Line::RefusedLength);
        }
        let erases = opcode == OPCODE_ERASE && !self.are_outputs_fixed();
        if erases {
            self.parameters.set_defaults(flash);
            self.apply_parameters();
        }
        let is_done = opcode == OPCODE_SAVE || erases;
        if is_done {
            self.store.save();
        }
        Reply { argument: is_done.into(), ..Reply::of(Line::Request) }
    }

    pub(super) fn respond_opcode<C, P>(
        &mut self,
        pending: &Pending,
        context: &mut Response<C, P>,
    ) -> bool {
        let mut is_done = pending.argument != 0;
        if is_done {
            if self.store.is_saving() {
                self.transmission.services.postpone(context.now_ms);
                return false;
            }
            is_done = self.store.is_saved();
            if is_done {
                self.record.health.clear(Conditions::PARAMETERS_LOST);
                self.update.parameters_are_saved();
            }
            context.monitor.log_line(if is_done { Line::Saved } else { Line::NotSaved });
        }
        // 48 bits of the argument, then one bit.
        self.transmission.outgoing.put_zeros(6);
        self.transmission.outgoing.put8(u8::from(is_done) << 7);
        true
    }

    pub(super) fn act_on_update(&mut self, request: &Transfer, _: impl Constants) -> Reply {
        let verdict = self.update.act_on_request(request, self.control.outputs.are_in_use()) as u8;
        if Verdict::is_accepted(verdict) {
            self.control.outputs.fail_safe(&self.parameters);
        }
        Reply { argument: verdict, ..Reply::of(Line::Request) }
    }

    pub(super) fn respond_update<C, P>(
        &mut self,
        pending: &Pending,
        context: &mut Response<C, P>,
    ) -> bool {
        // A restart would cut off the save, to which the response comes later.
        if ANSWERS_WHILE_SAVING && self.store.is_saving() {
            self.transmission.services.postpone(context.now_ms);
            return false;
        }
        let mut verdict = pending.argument;
        let mut error = ERROR_INVALID_MODE;
        if Verdict::is_accepted(verdict) {
            error = ERROR_OK;
            // The outputs may be in use again since the request.
            self.calls_off_update(context.monitor);
            if self.update.is_accepted() {
                self.update.answer();
            } else {
                verdict = Verdict::IN_USE;
                error = ERROR_INVALID_MODE;
            }
        }
        self.transmission.outgoing.put8(error);
        if !HAS_TEXTS {
            return true;
        }
        let (text_at, text_len) = Verdict::text(verdict);
        self.transmission.outgoing.payload.form = Form::Text;
        self.transmission.outgoing.payload.text_at = text_at;
        self.transmission.outgoing.payload.len = 1 + text_len;
        true
    }
}
