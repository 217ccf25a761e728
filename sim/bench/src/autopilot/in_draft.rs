//! The messages of the autopilot in the draft of 2014: status, commands and GetNodeInfo.

use super::{ANSWER_DELAY, Autopilot, CommandType, thesis_position};
use crate::Cycles;
use crate::can::Frame;
use crate::dronecan::NodeId;
use crate::dronecan::draft::{
    ActuatorCommand, DataType, Message, NodeStatus, Route, Transfer, TransferId, VendorCode,
};
use half::f16;

impl Autopilot {
    pub(super) fn handle_in_draft(&mut self, at: Cycles, transfer: &Transfer, message: Message) {
        match (message, transfer.route) {
            (Message::NodeStatus(status), _) => {
                self.handle_status(at, transfer.source, status.uptime_s)
            }
            (Message::NodeInfoRequest, Route::Request(asked)) if self.is_own_id(asked) => {
                let info =
                    Message::NodeInfo(Box::new(self.information(self.node_status_in_draft(at))));
                let answer = frames(
                    &info,
                    self.settings.node_id,
                    Route::Response(transfer.source),
                    transfer.transfer_id,
                );
                self.answers.push_back((at + ANSWER_DELAY, answer));
            }
            _ => {}
        }
    }

    /// NodeStatus in its form of 2015-03-19, with six bytes.
    fn node_status_in_draft(&self, at: Cycles) -> NodeStatus {
        NodeStatus {
            uptime_s: self.uptime_s(at),
            vendor_code: VendorCode::Short(0),
            ..NodeStatus::default()
        }
    }

    pub(super) fn status_in_draft(&self, at: Cycles) -> Message {
        Message::NodeStatus(self.node_status_in_draft(at))
    }

    pub(super) fn command_in_draft(&self, at: Cycles) -> Message {
        let deflection = self.deflection(at);
        if self.settings.command_type == CommandType::Thesis {
            return Message::ThesisCommand(thesis_position(deflection));
        }
        Message::ArrayCommand(vec![ActuatorCommand {
            actuator: self.settings.actuator,
            value: f16::from_f64(deflection),
        }])
    }

    pub(super) fn broadcast_in_draft(&mut self, message: &Message) -> Vec<Frame> {
        let (DataType { id, .. }, _) = message.encode().expect("only encodable messages are made");
        // A message that is not sent uses no transfer ID.
        let transfer_id = match self.mute {
            true => TransferId::default(),
            false => self.draft_transfers.entry(*id).or_default().advance(),
        };
        frames(message, self.settings.node_id, Route::Broadcast, transfer_id)
    }
}

/// The frames of a transfer.
fn frames(message: &Message, source: NodeId, route: Route, transfer_id: TransferId) -> Vec<Frame> {
    let (data_type, payload) = message.encode().expect("only encodable messages are made");
    let transfer = Transfer { type_id: data_type.id, source, route, transfer_id, payload };
    transfer.split(data_type.signature.unwrap_or(0))
}
