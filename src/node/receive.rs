//! What the node does with a received frame, and with the transfer that it completes: passes it to
//! the method that it is for, and counts and logs the result.

use dronecan_wire::{Rejection, Slot, Verdict};
use mcp2515_ordered::Frame;

use super::Node;
use super::health::count;
use super::trust::Receiver;
use crate::dialect;
use crate::monitor::{Line, Monitor};
use crate::parts::tunnel::HEADER_LEN;
use crate::tables::Constants;
use crate::tables::kind::Kind;
use crate::tables::wire::Transfer;

impl Node {
    /// Acts on a received frame and on the transfer that it completes.
    pub fn receive(
        &mut self,
        frame: &Frame,
        receiver: &mut Receiver,
        now_ms: u16,
        flash: impl Constants,
        monitor: &mut Monitor,
    ) {
        let segment = match dialect::segment(frame, self.identity.id) {
            Ok(segment) => segment,
            // With several outputs the filters let the frames of others pass.
            Err(Rejection::Anonymous | Rejection::Unknown) if self.control.outputs.used() > 1 => {
                return;
            }
            Err(rejection) => return self.record.reject(rejection, frame, monitor),
        };
        let kind = segment.kind;
        let (lights, outputs) = (&self.control.lights, &self.control.outputs);
        let slot_of = |id| -> Option<Slot> {
            if Kind::LightsCommand != Kind::Unknown && kind == Kind::LightsCommand {
                lights.slot_of(id)
            } else {
                outputs.slot_of(id)
            }
        };
        let transfer = match receiver.accept_entries(segment, slot_of, now_ms) {
            Verdict::More => return,
            Verdict::Rejected(rejection) => return self.record.reject(rejection, frame, monitor),
            Verdict::Request(_) if self.transmission.services.is_full() => {
                return self.record.reject(Rejection::Busy, frame, monitor);
            }
            Verdict::Message(transfer) | Verdict::Request(transfer) => transfer,
        };
        let source = transfer.source;
        self.record.note.set_source(source);
        self.record.note.set_transfer(transfer.transfer_id());
        let line = if transfer.kind.is_request() {
            self.record.note.set_a(dialect::data_type(transfer.kind, flash));
            let reply = self.act_on_request(transfer, flash);
            if !reply.line.is_refusal() {
                self.transmission.services.add(transfer, reply.argument, reply.value, now_ms);
            }
            reply.line
        } else {
            self.act(transfer, now_ms, monitor)
        };
        self.record.stats.count_received();
        if line.is_refusal() {
            count(&mut self.record.health.counts.refused);
            self.record.note.set_a(dialect::data_type(transfer.kind, flash));
            if line == Line::RefusedValue || line == Line::RefusedType {
                receiver.refused(source);
            }
        }
        self.record.log(line, monitor);
    }

    /// tunnel.Targetted: a character for the serial monitor, or the request to see it.
    #[allow(dead_code, reason = "a build may leave out its row")]
    pub(super) fn act_on_targetted(
        &mut self,
        message: &Transfer,
        now_ms: u16,
        monitor: &mut Monitor,
    ) -> Line {
        if !(HEADER_LEN..=HEADER_LEN + 1).contains(&message.len()) {
            return Line::RefusedLength;
        }
        let &[protocol, target, port, _, _, _, character, ..] = message.bytes();
        let header = [protocol, target, port];
        let is_for_us =
            self.console.tunnel.act_on_message(header, self.identity.id, message.source, now_ms);
        if is_for_us && message.len() > HEADER_LEN && character == b'?' {
            self.report(monitor);
        }
        Line::Targetted
    }
}
