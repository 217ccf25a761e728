//! What the node does with a received frame, and with the transfer that it completes: passes it to
//! the part that it is for, and counts and logs the result.

use dronecan_wire::{NodeId, Rejection, Slot, Verdict};
use mcp2515_ordered::Frame;

use super::Node;
use super::health::count;
use super::trust::Receiver;
use crate::dialect;
use crate::monitor::{Line, Monitor, Words};
use crate::parts::arming;
use crate::parts::tunnel::HEADER_LEN;
use crate::tables::Constants;
use crate::tables::condition::Conditions;
use crate::tables::kind::Kind;
use crate::tables::publication::Publication;
use crate::tables::wire::Transfer;

/// What else an action on a transfer needs.
pub struct Context<'a, P> {
    /// The time, in milliseconds.
    pub now_ms: u16,
    /// The tables in flash.
    pub flash: P,
    /// The log.
    pub monitor: &'a mut Monitor,
}

impl Node {
    /// Acts on a received frame and on the transfer that it completes.
    #[inline(always)]
    pub fn receive(
        &mut self,
        frame: &Frame,
        receiver: &mut Receiver,
        now_ms: u16,
        flash: impl Constants,
        monitor: &mut Monitor,
    ) {
        let segment = match dialect::segment(frame, self.id) {
            Ok(segment) => segment,
            Err(rejection) => return self.reject(rejection, frame, monitor),
        };
        let kind = segment.kind;
        let (lights, outputs) = (&self.lights, &self.outputs);
        let slot_of = |id| -> Option<Slot> {
            if Kind::LightsCommand != Kind::Unknown && kind == Kind::LightsCommand {
                lights.slot_of(id)
            } else {
                outputs.slot_of(id)
            }
        };
        let transfer = match receiver.accept_entries(segment, slot_of, now_ms) {
            Verdict::More => return,
            Verdict::Rejected(rejection) => return self.reject(rejection, frame, monitor),
            Verdict::Request(_) if self.services.is_full() => {
                return self.reject(Rejection::Busy, frame, monitor);
            }
            Verdict::Message(transfer) | Verdict::Request(transfer) => transfer,
        };
        let source = transfer.source;
        self.note.set_source(source);
        self.note.set_transfer(transfer.transfer_id());
        let mut context = Context { now_ms, flash, monitor };
        let line = if transfer.kind.is_request() {
            let reply = self.act_on_request(transfer, &mut context);
            if !reply.line.is_refusal() {
                self.services.add(transfer, reply.argument, reply.value);
            }
            reply.line
        } else {
            self.act(transfer, &mut context)
        };
        self.stats.count_received();
        if line.is_refusal() {
            count(&mut self.health.counts.refused);
            self.note.set_a(dialect::data_type(transfer.kind, flash));
            if line == Line::RefusedValue || line == Line::RefusedType {
                receiver.refused(source);
            }
        }
        self.log_note(line, monitor);
    }

    /// Logs a line with the values of the note.
    #[inline(never)]
    pub(super) fn log_note(&mut self, line: Line, monitor: &mut Monitor) {
        self.note.set_line(line);
        if line != Line::NONE
            && let Some(event) = monitor.log_frame(line)
        {
            *event = self.note;
        }
    }

    /// Counts and logs a frame that is dropped.
    #[inline(never)]
    fn reject(&mut self, rejection: Rejection, frame: &Frame, monitor: &mut Monitor) {
        let (data_type, source) = dialect::origin(frame);
        self.lose(rejection, data_type, source, monitor);
    }

    /// Counts and logs a frame or a transfer that is dropped.
    #[inline(never)]
    pub(super) fn lose(
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

    /// Takes note of the sender of a command. `is_second`: the output that followed it has two
    /// commanders.
    #[inline(never)]
    pub(super) fn commanded_by(&mut self, source: NodeId, is_second: bool, monitor: &mut Monitor) {
        let is_another = self.autopilot.commanded_by(source);
        if if arming::IS_BY_SOURCE { is_second } else { is_another } {
            self.health.set(Conditions::TWO_COMMANDERS, true, [Line::TwoCommanders; 2], monitor);
            self.health.happened(Conditions::TWO_COMMANDERS);
        }
    }

    /// Takes note of a command for an output. One that is rejected because the vehicle is disarmed
    /// still identifies the autopilot.
    #[inline(always)]
    fn note_command(&mut self, transfer: &Transfer, line: Line, monitor: &mut Monitor) -> Line {
        if line.is_refusal()
            && (line == Line::RefusedDisarmed || line == Line::RefusedSafe)
            && let Some(source) = NodeId::new(transfer.source)
        {
            self.commanded_by(source, false, monitor);
        }
        line
    }
}

/// The actions on messages, which the table of received types names.
#[allow(dead_code, reason = "a build may leave out the row that names one")]
impl Node {
    #[inline(always)]
    pub(super) fn act_on_array_command<P>(
        &mut self,
        command: &Transfer,
        context: &mut Context<P>,
    ) -> Line {
        let line = self.outputs.act_on_array_command(command, &self.parameters);
        self.note_command(command, line, context.monitor)
    }

    #[inline(always)]
    pub(super) fn act_on_raw_command<P>(
        &mut self,
        command: &Transfer,
        context: &mut Context<P>,
    ) -> Line {
        let line = self.outputs.act_on_raw_command(command, &self.parameters);
        self.note_command(command, line, context.monitor)
    }

    #[inline(always)]
    pub(super) fn act_on_servo_command<P>(
        &mut self,
        command: &Transfer,
        context: &mut Context<P>,
    ) -> Line {
        if command.len() != 1 {
            return Line::RefusedLength;
        }
        let line = self.outputs.act_on_servo_command(command, &self.parameters);
        self.note_command(command, line, context.monitor)
    }

    #[inline(always)]
    pub(super) fn act_on_status<P>(&mut self, status: &Transfer, context: &mut Context<P>) -> Line {
        let Some(heard) = dialect::read_status(status) else { return Line::RefusedLength };
        let [u0, u1, u2, u3] = heard.uptime;
        self.note.set_code(Words::HEALTH.number(heard.level));
        let uptime_s = if u2 | u3 == 0 { u16::from_le_bytes([u0, u1]) } else { u16::MAX };
        self.note.set_a(uptime_s);
        if self.is_of_autopilot(status) {
            self.publisher.autopilot_status(context.now_ms);
            if self.measurement.note_status() {
                self.publisher.publish(Publication::DegreesCelsius);
            }
        }
        Line::Status
    }

    #[inline(always)]
    pub(super) fn act_on_arming_status<P>(
        &mut self,
        status: &Transfer,
        _: &mut Context<P>,
    ) -> Line {
        if status.len() != 1 {
            return Line::RefusedLength;
        }
        if !self.is_of_autopilot(status) && !self.outputs.has_commander(status.source) {
            return Line::RefusedSource;
        }
        let (source, &[status, ..]) = (status.source, status.bytes());
        self.outputs.arming.act_on_status(source, status);
        self.note.set_code(status);
        Line::Arming
    }

    #[inline(always)]
    pub(super) fn act_on_safety_state<P>(
        &mut self,
        state: &Transfer,
        context: &mut Context<P>,
    ) -> Line {
        if state.len() != 1 {
            return Line::RefusedLength;
        }
        // A node whose commands are refused, because only another node's vehicle is armed, is the
        // autopilot, too. It must not stop what the other commands.
        if (self.outputs.arming.is_only_armed_by_others(state.source)
            || !self.is_of_autopilot(state))
            && !self.outputs.has_commander(state.source)
        {
            return Line::RefusedSource;
        }
        let (source, &[state, ..]) = (state.source, state.bytes());
        self.outputs.act_on_safety_state(source, state, context.now_ms, &self.parameters);
        if self.outputs.safety.is_safe() {
            self.health.clear(Conditions::FAILSAFE);
        }
        self.note.set_code(state);
        Line::SafetyState
    }

    /// True if a message is the autopilot's, as far as the node can tell.
    #[inline(never)]
    fn is_of_autopilot(&mut self, transfer: &Transfer) -> bool {
        NodeId::new(transfer.source).is_some_and(|source| self.autopilot.is_status_of(source))
    }

    #[inline(never)]
    pub(super) fn act_on_hardpoint_command<P>(
        &mut self,
        command: &Transfer,
        context: &mut Context<P>,
    ) -> Line {
        if command.len() != 3 {
            return Line::RefusedLength;
        }
        let (source, &[id, low, high, ..]) = (command.source, command.bytes());
        self.note.set_code(id);
        self.note.set_a(u16::from_le_bytes([low, high]));
        let holds = low | high != 0;
        let line = self.outputs.act_on_hardpoint_command(source, id, holds, &self.parameters);
        self.note_command(command, line, context.monitor)
    }

    #[inline(always)]
    pub(super) fn act_on_lights_command<P>(
        &mut self,
        command: &Transfer,
        _: &mut Context<P>,
    ) -> Line {
        self.lights.act_on_command(command.payload());
        self.note.set_code(self.lights.brightness());
        Line::Light
    }

    #[inline(always)]
    pub(super) fn act_on_targetted<P>(
        &mut self,
        message: &Transfer,
        context: &mut Context<P>,
    ) -> Line {
        if !(HEADER_LEN..=HEADER_LEN + 1).contains(&message.len()) {
            return Line::RefusedLength;
        }
        let &[protocol, target, port, _, _, _, character, ..] = message.bytes();
        let header = [protocol, target, port];
        let is_for_us = self.tunnel.act_on_message(header, self.id, message.source, context.now_ms);
        if is_for_us && message.len() > HEADER_LEN && character == b'?' {
            self.report(context.monitor);
        }
        Line::Targetted
    }

    #[inline(never)]
    pub(super) fn act_on_allocation<P>(
        &mut self,
        message: &Transfer,
        context: &mut Context<P>,
    ) -> Line {
        if self.id != 0 {
            return Line::AllocationElsewhere;
        }
        self.publisher.withdraw(Publication::Allocation);
        self.id = self.allocation.act_on_message(message, &self.unique_id, context.now_ms);
        self.note.set_code(self.id);
        if self.id == 0 {
            // An anonymous request is another node's.
            let is_request = message.source == 0;
            return if is_request { Line::RefusedSource } else { Line::AllocationElsewhere };
        }
        self.change_filters();
        Line::Allocated
    }
}
