//! The bridge itself: passes frames and messages, with their time, to the parts that handle them.
//!
//! Nothing here opens a connection, waits or reads a clock. The caller takes the output from
//! [`Bridge::frames`] and [`State::posts`].
//!
//! ```text
//! core ──> commands ──> forward, identity, presence ──> state ──> node, calls, post
//!      ──> parameters ────────────────────────────────>
//! ```

use crate::calls::Answer;
use crate::commands::Commands;
use crate::early::Early;
use crate::forward::Forward;
use crate::ftp;
use crate::message::{Content, FTP_PAYLOAD_LEN, In, Out, Request, warning};
use crate::node::Node;
use crate::post::{Asker, PeerId, Post, To};
use crate::presence::{CONFLICT_REPEATED_AFTER, NodeChange};
use crate::queue::Class;
use crate::state::{Settings, State};
use crate::task::{Op, Purpose};
use crate::tunnel::Tunnels;
use dronecan_host::{
    Assembler, CanId, Frame, Id, NodeId, NodeInfo, NodeStatus, Outcome, Transfer, TransferId, types,
};
use mavlink::dialects::common::MavMessage;
use std::collections::BTreeMap;
use std::time::Duration;

#[cfg(test)]
mod tests;

/// Period of heartbeats and of the bridge's own NodeStatus.
const HEARTBEAT_PERIOD: Duration = Duration::from_secs(1);
/// Services that the bridge requests or answers.
const SERVICES: [u16; 4] =
    [types::GET_NODE_INFO.id, types::GET_SET.id, types::EXECUTE_OPCODE.id, types::RESTART_NODE.id];

/// The nodes, and all requests in progress.
pub struct Bridge {
    state: State,
    commands: Commands,
    forward: Forward,
    early: Early,
    tunnels: Tunnels,
    assembler: Assembler,
    status_id: TransferId,
    next_beat: Duration,
    /// When the bridge last reported that another node has its node ID.
    conflict_logged_at: Option<Duration>,
    /// Frames to be sent on the bus.
    pub frames: Vec<Frame>,
}

impl Bridge {
    pub fn new(settings: Settings) -> Bridge {
        Bridge {
            tunnels: Tunnels::new(settings.node, &settings.tunnels),
            state: State::new(settings),
            commands: Commands::default(),
            forward: Forward::default(),
            early: Early::default(),
            assembler: Assembler::new(),
            status_id: TransferId::default(),
            next_beat: Duration::ZERO,
            conflict_logged_at: None,
            frames: Vec::new(),
        }
    }

    /// The nodes that have sent a status.
    pub fn nodes(&self) -> &BTreeMap<NodeId, Node> {
        &self.state.nodes
    }

    /// Takes the messages for the ground stations.
    pub fn take_posts(&mut self) -> Vec<Post> {
        std::mem::take(&mut self.state.posts)
    }

    /// Adds a line to the log.
    pub fn log_line(&mut self, line: String) {
        self.state.log.push(line);
    }

    /// Takes the lines of the log.
    pub fn take_log(&mut self) -> Vec<String> {
        std::mem::take(&mut self.state.log)
    }

    /// Handles a frame from the bus.
    pub fn frame(&mut self, now: Duration, frame: &Frame) {
        self.forward.show(&mut self.state, now, frame, None);
        self.receive_frame(now, frame);
        self.send(now);
    }

    /// Moves the parts' frames to [`Bridge::frames`], and forwards them to the stations that
    /// subscribed to the bus.
    fn send(&mut self, now: Duration) {
        for (frame, from) in std::mem::take(&mut self.state.outgoing) {
            self.frames.push(frame);
            self.forward.show(&mut self.state, now, &frame, from);
        }
    }

    /// Handles a frame on the bus that the bridge did not send.
    fn receive_frame(&mut self, now: Duration, frame: &Frame) {
        let Id::Extended(raw) = frame.id else { return };
        let Some(id) = CanId::parse(raw).filter(|_| !frame.remote) else { return };
        let own = self.state.settings.node;
        if id.source() == Some(own) {
            return self.report_conflict(now);
        }
        let ours = match id {
            CanId::Message { type_id, source, .. } => {
                type_id == types::NODE_STATUS.id || self.tunnels.wants(type_id, source)
            }
            CanId::Service { destination, service_id, .. } => {
                destination == own && SERVICES.contains(&service_id.into())
            }
            CanId::Anonymous { .. } => false,
        };
        // Other transfers are not reassembled, so that many incomplete ones take no memory.
        if ours && let Outcome::Complete(transfer) = self.assembler.push(raw, frame.data(), now) {
            self.transfer(now, &transfer);
        }
    }

    fn report_conflict(&mut self, now: Duration) {
        if self
            .conflict_logged_at
            .is_none_or(|logged_at| now >= logged_at + CONFLICT_REPEATED_AFTER)
        {
            self.conflict_logged_at = Some(now);
            let id = self.state.settings.node;
            self.state.warn(&format!("another node has the bridge's ID {id}: --node-id"));
        }
    }

    fn transfer(&mut self, now: Duration, transfer: &Transfer) {
        match transfer.id {
            CanId::Message { type_id, .. } if type_id != types::NODE_STATUS.id => {
                self.tunnels.receive(transfer)
            }
            CanId::Message { source, .. } => {
                if let Some(status) = NodeStatus::decode(&transfer.payload) {
                    self.node_status(now, source, status, transfer.transfer_id);
                }
            }
            CanId::Service { request: true, service_id, source, priority, .. } => {
                if u16::from(service_id) == types::GET_NODE_INFO.id {
                    self.state.answer_node_info(now, source, priority, transfer.transfer_id);
                }
            }
            CanId::Service { request: false, .. } => {
                if let Some(answer) = self.state.calls.answered(now, transfer) {
                    self.answer(now, answer);
                }
            }
            CanId::Anonymous { .. } => {}
        }
    }

    fn node_status(&mut self, now: Duration, id: NodeId, status: NodeStatus, sent: TransferId) {
        let was_online = self.state.nodes.get(&id).is_some_and(|node| node.is_online);
        let change = self.state.note_status(now, id, status, sent);
        if change == NodeChange::Restarted {
            self.commands.restarted(&mut self.state, id);
        }
        if change != NodeChange::Nothing {
            self.state.forget_parameters(id);
            self.state.request_info(id);
        }
        if !was_online {
            for (asker, message) in self.early.take(id, self.state.settings.system) {
                self.message(now, asker, message);
            }
        }
        self.state.post_status(now, id, &status);
    }

    /// Handles the answer to a request, or its failure.
    fn answer(&mut self, now: Duration, (id, purpose, payload): Answer<Purpose>) {
        match purpose {
            Purpose::Info => {
                let info = payload.as_deref().and_then(NodeInfo::decode);
                let done = if info.is_some() { Ok(()) } else { Err("does not answer GetNodeInfo") };
                for command in self.state.info_answer(now, id, info) {
                    self.commands.done(&mut self.state, command, id, done);
                }
            }
            Purpose::Item(_) | Purpose::Read { .. } | Purpose::Set { .. } => {
                self.state.parameter_answer(now, id, purpose, payload.as_deref());
            }
            Purpose::Opcode(_) | Purpose::Restart(_) | Purpose::Autosave => {
                self.commands.answer(&mut self.state, id, purpose, payload.as_deref());
            }
        }
    }

    /// Handles a message from a ground station.
    pub fn message(&mut self, now: Duration, asker: Asker, message: In) {
        let (system, component) = message.to;
        if system != 0 && system != self.state.settings.system {
            return;
        }
        self.early.keep(&self.state, now, asker, &message);
        let state = &mut self.state;
        match message.request {
            Request::Heartbeat { kind, autopilot } => {
                state.note_component(asker.from, kind, autopilot)
            }
            // The channel has slowed down already.
            Request::Other | Request::Radio { .. } => {}
            Request::ParameterList => state.parameter_ops(component, || Op::List(asker)),
            Request::ParameterRead { index: Some(index), .. } => {
                state.parameter_ops(component, || Op::ReadIndex(asker, index));
            }
            Request::ParameterRead { index: None, name } => {
                state.parameter_ops(component, || Op::ReadName(asker, name.clone()));
            }
            Request::ParameterSet { name, value, kind } => {
                // PARAM_SET needs one node: the same value for all nodes makes no sense.
                if component != 0 {
                    let set = || Op::Set { asker, name: name.clone(), value, kind };
                    state.parameter_ops(component, set);
                }
            }
            Request::Command(command) => {
                self.commands.take(state, &mut self.forward, now, asker, component, command);
            }
            Request::Frame(data) => {
                if let Some(frame) = self.forward.frame_from_station(state, asker, &data) {
                    self.send(now);
                    // A node ID that a station uses is a node like any other.
                    self.receive_frame(now, &frame);
                }
            }
            Request::Ftp(request) => self.ftp(asker, component, &request),
            Request::Filter(data) => self.forward.filter(state, now, asker, &data),
        }
        self.send(now);
    }

    /// Rejects file requests to the bridge or to a node that is online.
    fn ftp(&mut self, asker: Asker, component: u8, request: &[u8; FTP_PAYLOAD_LEN]) {
        let own = self.state.settings.component;
        let is_node = NodeId::new(component).is_some_and(|id| self.state.nodes.contains_key(&id));
        let answering = match component {
            0 => own,
            _ if component == own || (is_node && !self.state.is_other_component(component)) => {
                component
            }
            _ => return,
        };
        if let Some(content) = ftp::answer(asker.from, request) {
            self.state.answer(asker, answering, content);
        }
    }

    /// The bridge's own heartbeat, for a station that has no place yet.
    pub fn heartbeat(&self) -> Out {
        self.own(self.state.heartbeat(None))
    }

    /// A STATUSTEXT of the bridge, for a station that has no place yet.
    pub fn warning(&self, words: &str) -> Out {
        self.own(warning(words))
    }

    fn own(&self, message: MavMessage) -> Out {
        Out { component: self.state.settings.component, content: Content::from(message) }
    }

    /// Sends a new ground station a heartbeat and the known nodes.
    pub fn joined(&mut self, now: Duration, peer: PeerId) {
        let (own, heartbeat) = (self.state.settings.component, self.state.heartbeat(None));
        self.state.post(To::One(peer), Class::Answer, own, heartbeat);
        self.state.send_all_infos(now, peer);
    }

    /// Handles that the bus is open again. Other nodes may be on it now, and their uptimes need not
    /// show that.
    pub fn bus_is_back(&mut self) {
        let online: Vec<NodeId> = self.state.online_nodes().collect();
        for id in online {
            self.state.forget_parameters(id);
            self.state.request_info(id);
        }
    }

    /// Forgets a ground station.
    pub fn left(&mut self, peer: PeerId) {
        self.forward.drop_station(peer);
        self.early.drop_station(peer);
        self.commands.drop_station(peer);
    }

    /// Executes everything that is due.
    pub fn poll(&mut self, now: Duration) {
        self.state.check_offline_nodes(now);
        self.state.repeat_infos(now);
        self.state.autosave(now);
        if now >= self.next_beat {
            // Missed heartbeats are not sent later.
            self.next_beat = if now < self.next_beat + HEARTBEAT_PERIOD {
                self.next_beat + HEARTBEAT_PERIOD
            } else {
                now + HEARTBEAT_PERIOD
            };
            self.state.send_heartbeats(now, self.status_id.advance());
        }
        let mut requests = Vec::new();
        let failed = self.state.calls.poll(now, &mut requests);
        self.tunnels.poll(now, &mut requests);
        self.state.outgoing.extend(requests.into_iter().map(|frame| (frame, None)));
        for answer in failed {
            self.answer(now, answer);
        }
        self.send(now);
        self.forward.poll(now);
        self.early.poll(now);
    }

    /// When [`poll`](Bridge::poll) must be called at the latest.
    pub fn deadline(&self) -> Duration {
        let deadlines = [self.state.calls.deadline(), self.tunnels.deadline()];
        deadlines.into_iter().flatten().fold(self.next_beat, Duration::min)
    }

    /// The tunnels to serial ports of nodes.
    pub fn tunnels(&self) -> &Tunnels {
        &self.tunnels
    }

    pub fn tunnels_mut(&mut self) -> &mut Tunnels {
        &mut self.tunnels
    }

    /// Fetches the parameters of all nodes, for `--names`.
    pub fn list_all(&mut self) {
        self.state.parameter_ops(0, || Op::Print);
    }

    /// True while parameters are being fetched.
    pub fn is_listing(&self) -> bool {
        self.state.nodes.values().any(|node| node.listing.is_some())
    }
}
