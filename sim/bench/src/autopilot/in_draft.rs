//! The messages of the autopilot in the draft of 2014: status, commands and GetNodeInfo.

use super::send::thesis_position;
use super::{ANSWER_DELAY, Autopilot, CommandType};
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
        let deflection = self.own_deflection(at);
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
    transfer.split(data_type.seed.unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::super::{Only, Profile, Settings};
    use super::*;
    use crate::F_CPU_HZ;
    use crate::can::Id;
    use crate::dronecan::Dialect;

    fn in_draft(profile: Profile, only: Option<Only>) -> Autopilot {
        let settings = Settings { only, ..Settings::of(profile).in_dialect(Dialect::Draft) };
        Autopilot::new(settings, 1_000_000)
    }

    /// Frames that `autopilot` sends before `until`, in candump's notation.
    fn frames_of(autopilot: &mut Autopilot, until: Cycles) -> Vec<String> {
        autopilot.due(until).into_iter().map(|(_, frame)| frame.to_string()).collect()
    }

    #[test]
    fn in_the_draft_the_status_and_the_commands_are_frames_of_the_draft() {
        let mut autopilot = in_draft(Profile::Plain, None);
        autopilot.hold(0.5);
        let frames = frames_of(&mut autopilot, 2 * F_CPU_HZ);
        assert_eq!(frames[..3], ["11340408#000000000000", "084C0408#010038", "084C0409#010038"]);
        assert_eq!(frames[51], "11340409#010000000000");
        assert_eq!(frames.iter().filter(|frame| frame.starts_with("1134")).count(), 2);
        assert_eq!(frames.iter().filter(|frame| frame.starts_with("084C")).count(), 100);
        // After the eight transfer IDs of the draft comes the first again.
        assert_eq!(
            (frames[8].as_str(), frames[9].as_str()),
            ("084C040F#010038", "084C0408#010038")
        );
    }

    #[test]
    fn the_autopilot_of_the_thesis_commands_one_byte_in_the_draft() {
        let mut autopilot = in_draft(Profile::Thesis, None);
        for (deflection, expected) in [(-1.0, "00"), (0.0, "80"), (1.0, "FF")] {
            autopilot.hold(deflection);
            let until = autopilot.next_command_at + 1;
            let frame = frames_of(&mut autopilot, until).pop().unwrap();
            assert_eq!(&frame[..8], format!("17C4040{:X}", 8 + autopilot.commands_sent() - 1));
            assert_eq!(&frame[9..], expected);
        }
    }

    #[test]
    fn the_autopilot_answers_get_node_info_in_its_dialect_and_ignores_the_other() {
        for (profile, request) in [(Profile::Px4, "1E0181FF#C7"), (Profile::Plain, "113BFC08#01")] {
            for dialect in [Dialect::V0, Dialect::Draft] {
                let mut autopilot =
                    Autopilot::new(Settings::of(profile).in_dialect(dialect), 1_000_000);
                autopilot.set_silent(false);
                autopilot.receive(F_CPU_HZ, &request.parse().unwrap());
                let asked_in = if request.starts_with("1E") { Dialect::V0 } else { Dialect::Draft };
                assert_eq!(
                    autopilot.answers.len(),
                    usize::from(dialect == asked_in),
                    "{request} {dialect}"
                );
            }
        }
        let mut autopilot = in_draft(Profile::Plain, None);
        autopilot.receive(F_CPU_HZ, &"113BFC0D#01".parse().unwrap());
        let (at, frames) = autopilot.answers.pop_front().unwrap();
        assert_eq!(at, F_CPU_HZ + ANSWER_DELAY);
        // To 127, from 1, with the transfer ID of the request; the uptime is one second.
        assert_eq!(frames[0].id, Id::Extended(0x1138_0405));
        assert_eq!(frames[0].data()[..1], [0x7F]);
        assert_eq!(frames[0].data()[3..8], [1, 0, 0, 0, 0]);
        let text: Vec<u8> = frames.iter().flat_map(|frame| frame.data()[1..].to_vec()).collect();
        assert!(text.ends_with(b"org.example.autopilot"), "{frames:?}");
    }

    #[test]
    fn settings_keep_what_the_other_dialect_has() {
        let settings = Settings { actuator: 3, ..Settings::of(Profile::ArdupilotPwm) }
            .in_dialect(Dialect::Draft);
        assert_eq!(
            (settings.profile, settings.command_type),
            (Profile::Plain, CommandType::Unitless)
        );
        assert_eq!((settings.actuator, settings.node_id.get()), (3, 10));
        let settings =
            Settings::of(Profile::Thesis).in_dialect(Dialect::Draft).in_dialect(Dialect::V0);
        assert_eq!(
            (settings.profile, settings.command_type),
            (Profile::Thesis, CommandType::Thesis)
        );
        let mut autopilot = in_draft(Profile::Plain, None);
        let types = [(); 3].map(|()| {
            autopilot.next_command_type();
            autopilot.settings().command_type
        });
        assert_eq!(types, [CommandType::Thesis, CommandType::Unitless, CommandType::Thesis]);
    }
}
