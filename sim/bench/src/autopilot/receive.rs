//! What the autopilot receives, and its answers.

use super::{
    ALLOCATION_PRIORITY, ANSWER_DELAY, Autopilot, OFFLINE_TIMEOUT, PARAMETER_PRIORITY, frames,
};
use crate::can::{Frame, Id};
use crate::dronecan::{
    Allocation, CanId, Decoded, Dialect, Message, NodeId, NodeInfo, NodeStatus, Observation,
    ParameterRequest, Transfer, text::hex, types,
};
use crate::{Cycles, F_CPU_HZ};

impl Autopilot {
    pub(super) fn receive(&mut self, at: Cycles, frame: &Frame) {
        let Id::Extended(id) = frame.id else { return };
        if frame.remote {
            return;
        }
        match self.observer.push(id, frame.data(), crate::elapsed(at)) {
            Observation::Complete(Decoded::V0(transfer, message))
                if self.settings.dialect == Dialect::V0 =>
            {
                self.handle(at, &transfer, message);
            }
            Observation::Complete(Decoded::Draft(transfer, message))
                if self.settings.dialect == Dialect::Draft =>
            {
                self.handle_in_draft(at, &transfer, message);
            }
            Observation::Complete(_) | Observation::Partial | Observation::Invalid(_) => {}
        }
    }

    fn handle(&mut self, at: Cycles, transfer: &Transfer, message: Message) {
        match (message, transfer.id) {
            (Message::NodeStatus(status), CanId::Message { source, .. }) => {
                self.handle_status(at, source, status.uptime_s)
            }
            (Message::Allocation(request), CanId::Anonymous { .. }) => self.allocate(at, &request),
            (Message::NodeInfo(info), CanId::Service { source, destination, .. })
                if self.is_own_id(destination) =>
            {
                let node = self.nodes.entry(source).or_default();
                node.ask_at = None;
                if !std::mem::replace(&mut node.is_reported, true) {
                    self.events.push((at, format!("{source} is {info}")));
                    self.read_parameter(at, source);
                }
            }
            (Message::ParameterResponse(parameter), CanId::Service { source, destination, .. })
                if self.is_own_id(destination) =>
            {
                self.events.push((at, format!("{source} has {parameter}")));
            }
            (
                Message::NodeInfoRequest,
                CanId::Service { priority, service_id, destination, source, .. },
            ) if self.is_own_id(destination) => {
                let id = CanId::Service {
                    priority,
                    service_id,
                    request: false,
                    destination: source,
                    source: destination,
                };
                let info = Message::NodeInfo(Box::new(self.information(self.status(at))));
                self.answers
                    .push_back((at + ANSWER_DELAY, frames(id, transfer.transfer_id, &info)));
            }
            _ => {}
        }
    }

    pub(super) fn is_own_id(&self, id: NodeId) -> bool {
        id == self.settings.node_id
    }

    pub(super) fn handle_status(&mut self, at: Cycles, source: NodeId, uptime_s: u32) {
        if let Some(allocator) = &mut self.allocator {
            allocator.add_taken(source);
        }
        let is_known = self.nodes.contains_key(&source);
        let node = self.nodes.entry(source).or_default();
        let is_new =
            !is_known || uptime_s < node.uptime_s || at - node.last_status_at > OFFLINE_TIMEOUT;
        if is_new
            && self.settings.dialect == Dialect::V0
            && self.settings.profile.request_priority().is_some()
        {
            node.ask_at = Some(at + ANSWER_DELAY);
            node.is_reported = false;
        }
        (node.last_status_at, node.uptime_s) = (at, uptime_s);
    }

    /// Requests the parameter of the settings from a node.
    fn read_parameter(&mut self, at: Cycles, destination: NodeId) {
        let Some(name) = self.settings.parameter.clone() else { return };
        let source = self.settings.node_id;
        let (priority, service_id) = (PARAMETER_PRIORITY, types::GET_SET.id as u8);
        let id = CanId::Service { priority, service_id, request: true, destination, source };
        let request = ParameterRequest { name: name.into_bytes(), ..ParameterRequest::default() };
        let transfer_id = self.next_transfer(id);
        let frames = frames(id, transfer_id, &Message::ParameterRequest(request));
        self.answers.push_back((at + ANSWER_DELAY, frames));
    }

    fn allocate(&mut self, at: Cycles, request: &Allocation) {
        let Some(answer) =
            self.allocator.as_mut().and_then(|allocator| allocator.answer(request, at))
        else {
            return;
        };
        if answer.node_id != 0 {
            let text =
                format!("{} is allocated to unique ID {}", answer.node_id, hex(&answer.unique_id));
            self.events.push((at, text));
        }
        let message = Message::Allocation(answer);
        let id = self.broadcast_id(&message, ALLOCATION_PRIORITY);
        let transfer_id = self.next_transfer(id);
        self.answers.push_back((at + ANSWER_DELAY, frames(id, transfer_id, &message)));
    }

    pub(super) fn information<S: Default>(&self, status: S) -> NodeInfo<S> {
        NodeInfo {
            status,
            software: (4, 6),
            hardware: (1, 0),
            // Differs from the unique ID of any board, which the board makes from noise.
            unique_id: *b"sim's autopilot ",
            name: self.settings.profile.name().into(),
            ..NodeInfo::default()
        }
    }

    pub(super) fn uptime_s(&self, at: Cycles) -> u32 {
        u32::try_from((at - self.powered_at) / F_CPU_HZ).unwrap_or(u32::MAX)
    }

    pub(super) fn status(&self, at: Cycles) -> NodeStatus {
        NodeStatus { uptime_s: self.uptime_s(at), ..NodeStatus::default() }
    }
}
