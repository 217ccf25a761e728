//! What the node does at a request, and what its response has.

use super::Node;
use super::get_set::GetSet;
use super::outgoing::Form;
use super::services::{ANSWERS_WHILE_SAVING, Pending, Reply, Response};
use crate::hardware::{CanCounters, OUTPUTS};
use crate::monitor::Line;
use crate::parts::stats;
use crate::parts::update::{HAS_TEXTS, Verdict};
use crate::tables::condition::Conditions;
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
    #[inline(always)]
    pub(super) fn accept(&mut self, _: &Transfer, _: impl Constants) -> Reply {
        Reply::of(Line::Request)
    }

    #[inline(always)]
    pub(super) fn respond_node_info<C, P>(
        &mut self,
        _: &Pending,
        context: &mut Response<C, P>,
    ) -> bool {
        self.put_status(context.now_ms);
        self.transmission.outgoing.payload.form = Form::NodeInfo;
        self.transmission.outgoing.payload.len = information::NODE_INFO_LEN;
        true
    }

    #[inline(always)]
    pub(super) fn respond_stats<C: CanCounters, P>(
        &mut self,
        _: &Pending,
        context: &mut Response<C, P>,
    ) -> bool {
        self.record
            .stats
            .put_transport(context.counters, |number| self.transmission.outgoing.put32(number));
        self.transmission.outgoing.payload.form = Form::Numbers48;
        self.transmission.outgoing.payload.len = stats::LEN;
        true
    }

    #[inline(always)]
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
    #[inline(always)]
    pub(super) fn respond_ok<C, P>(&mut self, pending: &Pending, _: &mut Response<C, P>) -> bool {
        // A restart would cut off the save, to which the response comes later.
        if ANSWERS_WHILE_SAVING && self.store.is_saving() {
            self.transmission.services.postpone();
            return false;
        }
        self.transmission.outgoing.put8(pending.argument << 7);
        true
    }

    /// True if type, ID and number of the outputs must not change, because the vehicle is armed: a
    /// motor would stop. A single output is no motor.
    #[inline(always)]
    fn are_outputs_fixed(&self) -> bool {
        OUTPUTS > 1 && self.control.outputs.arming.is_armed()
    }

    #[inline(always)]
    pub(super) fn act_on_get_set(&mut self, request: &Transfer, flash: impl Constants) -> Reply {
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
            self.record.note.set_a(value as u16);
            self.record.note.set_b(u16::from(parameter));
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
            self.transmission.outgoing.put_zeros(4);
            return true;
        }
        let payload = &mut self.transmission.outgoing.payload;
        payload.form = Form::Parameter;
        (payload.parameter, payload.len) =
            parameters::Response::new(pending.argument, pending.value, context.flash);
        true
    }

    #[inline(always)]
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
            if !self.transmission.services.is_saving {
                self.transmission.services.is_saving = true;
                self.store.save();
            }
            if self.store.is_saving() {
                self.transmission.services.postpone();
                return false;
            }
            is_done = self.store.is_saved();
            if is_done {
                self.record.health.clear(Conditions::PARAMETERS_LOST);
                self.update.parameters_are_saved();
            }
            self.transmission.services.is_saving = false;
            context.monitor.log_line(if is_done { Line::Saved } else { Line::NotSaved });
        }
        // 48 bits of the argument, then one bit.
        self.transmission.outgoing.put_zeros(6);
        self.transmission.outgoing.put8(u8::from(is_done) << 7);
        true
    }

    #[inline(always)]
    pub(super) fn act_on_update(&mut self, request: &Transfer, _: impl Constants) -> Reply {
        let verdict = self.update.act_on_request(request, self.control.outputs.are_in_use()) as u8;
        if Verdict::is_accepted(verdict) {
            self.control.outputs.fail_safe(&self.parameters);
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
            self.transmission.services.postpone();
            return false;
        }
        let is_accepted = Verdict::is_accepted(pending.argument);
        self.transmission.outgoing.put8(if is_accepted { ERROR_OK } else { ERROR_INVALID_MODE });
        if !HAS_TEXTS {
            return true;
        }
        let (text_at, text_len) = Verdict::text(pending.argument);
        self.transmission.outgoing.payload.form = Form::Text;
        self.transmission.outgoing.payload.text_at = text_at;
        self.transmission.outgoing.payload.len = 1 + text_len;
        true
    }
}
