//! The bridge itself: nodes on one side, ground stations on the other, and what each is told of the other.
//!
//! Nothing here opens, waits or reads a clock: frames and messages come in with the time, and what is to be sent is taken out of
//! [`Bridge::frames`] and [`Bridge::posts`]. Node status, information and the node's own part on the bus are here; [`crate::parameters`],
//! [`crate::commands`] and [`crate::forward`] are the rest of it.

use crate::calls::{Answer, Calls, Patience};
use crate::commands::Pending;
use crate::forward::Subscriber;
use crate::message::{Content, In, Out, Request, chars, text};
use crate::node::Node;
use crate::number::Custom;
use crate::parameters::{Op, Purpose};
use crate::queue::Class;
use dronecan_host::{
    Assembler, CanId, Frame, Health, Id, Mode, NodeId, NodeInfo, NodeStatus, Outcome, Transfer, TransferId, split,
    types,
};
use mavlink::dialects::common::{
    HEARTBEAT_DATA, MavAutopilot, MavMessage, MavModeFlag, MavState, MavType, UAVCAN_NODE_INFO_DATA,
    UAVCAN_NODE_STATUS_DATA, UavcanNodeHealth, UavcanNodeMode,
};
use std::collections::BTreeMap;
use std::time::Duration;

#[cfg(test)]
mod tests;

/// A node is gone when its last status is older.
pub const OFFLINE_AFTER: Duration = Duration::from_secs(5);
/// Heartbeats, and the bridge's own NodeStatus.
const BEAT: Duration = Duration::from_secs(1);
const INFO_PATIENCE: Patience = Patience::new(500, 3);
/// A node that does not say who it is will be asked again after this, then twice, four times.. as long.
const INFO_RETRY: Duration = Duration::from_secs(2);
const INFO_RETRY_MAX: Duration = Duration::from_secs(60);
/// The bridge's statuses have the priority of other nodes'.
const STATUS_PRIORITY: u8 = 24;
/// What is for a node that has not been heard yet waits that long for it: all nodes show themselves each second.
const EARLY_FOR: Duration = Duration::from_secs(3);
const EARLY_MAX: usize = 32;
/// What the bridge asks for or answers.
const SERVICES: [u16; 4] =
    [types::GET_NODE_INFO.id, types::GET_SET.id, types::EXECUTE_OPCODE.id, types::RESTART_NODE.id];
/// How the bridge is called on the bus.
pub const NAME: &str = "org.dronecan.mavlink_bridge";
const MAVLINK_VERSION: u8 = 3;

/// A ground station, or what leads to some.
pub type PeerId = u32;

/// Who the bridge is, and how often it says what.
#[derive(Clone, Debug)]
pub struct Settings {
    /// MAVLink system, for the bridge and all nodes.
    pub system: u8,
    /// The bridge's MAVLink component.
    pub component: u8,
    /// The bridge's node ID on the bus.
    pub node: NodeId,
    pub unique_id: [u8; 16],
    /// How often all ground stations are told who the nodes are.
    pub info_interval: Duration,
    /// Save a node's parameters by itself, that long after the last was set.
    pub autosave: Option<Duration>,
    /// Unix time at time 0, in microseconds.
    pub epoch_us: u64,
}

/// Who asks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Asker {
    pub peer: PeerId,
    /// System and component.
    pub from: (u8, u8),
    /// How it writes integers.
    pub custom: Custom,
}

/// To whom a message goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum To {
    All,
    One(PeerId),
}

/// What is to be put into the queues of ground stations.
#[derive(Clone, Debug, PartialEq)]
pub enum Post {
    Message {
        to: To,
        class: Class,
        out: Out,
    },
    Status {
        node: NodeId,
        out: Out,
    },
    /// The node is gone: its last status is no news.
    Forget {
        node: NodeId,
    },
}

/// All that is known, and all that is under way.
pub struct Bridge {
    pub(crate) settings: Settings,
    pub(crate) nodes: BTreeMap<NodeId, Node>,
    pub(crate) calls: Calls<Purpose>,
    pub(crate) commands: BTreeMap<u32, Pending>,
    pub(crate) next_command: u32,
    pub(crate) subscribers: BTreeMap<PeerId, Subscriber>,
    assembler: Assembler,
    status_id: TransferId,
    next_beat: Duration,
    /// For nodes that have not been heard yet, with the time when it is forgotten.
    early: Vec<(Duration, Asker, In)>,
    /// Somebody else has our node ID; when that was last said.
    conflict_said: Option<Duration>,
    /// To be sent on the bus.
    pub frames: Vec<Frame>,
    pub posts: Vec<Post>,
    /// Lines for people.
    pub log: Vec<String>,
}

impl Bridge {
    pub fn new(settings: Settings) -> Bridge {
        Bridge {
            calls: Calls::new(settings.node),
            settings,
            nodes: BTreeMap::new(),
            commands: BTreeMap::new(),
            next_command: 0,
            subscribers: BTreeMap::new(),
            assembler: Assembler::new(),
            status_id: TransferId::default(),
            next_beat: Duration::ZERO,
            early: Vec::new(),
            conflict_said: None,
            frames: Vec::new(),
            posts: Vec::new(),
            log: Vec::new(),
        }
    }

    /// The nodes that have been heard.
    pub fn nodes(&self) -> &BTreeMap<NodeId, Node> {
        &self.nodes
    }

    /// A frame from the bus.
    pub fn frame(&mut self, now: Duration, frame: &Frame) {
        self.forward(now, frame, None);
        self.hear(now, frame);
    }

    /// A frame that is on the bus and not ours, whoever sent it.
    pub(crate) fn hear(&mut self, now: Duration, frame: &Frame) {
        let Id::Extended(raw) = frame.id else { return };
        let Some(id) = CanId::parse(raw).filter(|_| !frame.remote) else { return };
        if id.source() == Some(self.settings.node) {
            return self.tell_conflict(now);
        }
        let ours = match id {
            CanId::Message { type_id, .. } => type_id == types::NODE_STATUS.id,
            CanId::Service { destination, service_id, .. } => {
                destination == self.settings.node && SERVICES.contains(&service_id.into())
            }
            CanId::Anonymous { .. } => false,
        };
        // Nothing else is put together, so that no flood of transfers that are begun and never end costs memory.
        if ours && let Outcome::Complete(transfer) = self.assembler.push(raw, frame.data(), now) {
            self.transfer(now, &transfer);
        }
    }

    fn tell_conflict(&mut self, now: Duration) {
        if self.conflict_said.is_none_or(|said| now >= said + Duration::from_secs(60)) {
            self.conflict_said = Some(now);
            let id = self.settings.node;
            self.log.push(format!("another node has the bridge's ID {id}: choose a free one with --node-id"));
        }
    }

    fn transfer(&mut self, now: Duration, transfer: &Transfer) {
        match transfer.id {
            CanId::Message { source, .. } => {
                if let Some(status) = NodeStatus::decode(&transfer.payload) {
                    self.node_status(now, source, status);
                }
            }
            CanId::Service { request: true, service_id, source, priority, .. } => {
                if u16::from(service_id) == types::GET_NODE_INFO.id {
                    self.tell_who_we_are(now, source, priority, transfer.transfer_id);
                }
            }
            CanId::Service { request: false, .. } => {
                if let Some(answer) = self.calls.answered(transfer) {
                    self.answer(now, answer);
                }
            }
            CanId::Anonymous { .. } => {}
        }
    }

    fn node_status(&mut self, now: Duration, id: NodeId, status: NodeStatus) {
        let known = self.nodes.entry(id).or_insert_with(|| Node { online: false, ..Node::new(status, now) });
        let restarted = status.uptime_s < known.status.uptime_s;
        let appeared = !known.online;
        known.status = status;
        known.heard = now;
        known.online = true;
        known.statuses += 1;
        if appeared || restarted {
            let words = if appeared { "is there" } else { "has restarted" };
            self.log.push(format!("node {id} {words}: {status}"));
            if restarted {
                self.post(To::All, Class::Text, id.get(), Content::from(text(&format!("Node {id} has restarted"))));
                self.restarted(id);
            }
            self.forget_what_it_said(id);
            self.ask_who_it_is(id);
            if appeared {
                self.early_messages(now, id);
            }
        }
        let out = Out { component: id.get(), content: self.status_content(now, &status) };
        self.posts.push(Post::Status { node: id, out });
    }

    /// After a restart it may be another firmware.
    fn forget_what_it_said(&mut self, id: NodeId) {
        let failed = self.calls.take_back(id, |purpose| matches!(purpose, Purpose::Item(_) | Purpose::Info));
        let Some(node) = self.nodes.get_mut(&id) else { return };
        node.table = None;
        node.save_at = None;
        node.info.known = None;
        node.info.failures = 0;
        for purpose in failed {
            match purpose {
                Purpose::Info => node.info.asked = false,
                _ => node.listing = None,
            }
        }
        // What waited for its parameters still wants them.
        if !node.waiting.is_empty() && node.listing.is_none() {
            self.list(id);
        }
    }

    pub(crate) fn ask_who_it_is(&mut self, id: NodeId) {
        if let Some(node) = self.nodes.get_mut(&id)
            && !node.info.asked
        {
            node.info.asked = true;
            self.calls.request(id, types::GET_NODE_INFO, Vec::new(), INFO_PATIENCE, Purpose::Info);
        }
    }

    /// An answer, or that there is none.
    pub(crate) fn answer(&mut self, now: Duration, (id, purpose, payload): Answer<Purpose>) {
        match purpose {
            Purpose::Info => self.info_answer(now, id, payload.as_deref().and_then(NodeInfo::decode)),
            Purpose::Item(_) | Purpose::Read { .. } | Purpose::Set { .. } => {
                self.parameter_answer(now, id, purpose, payload.as_deref());
            }
            Purpose::Opcode(_) | Purpose::Restart(_) | Purpose::Autosave => {
                self.command_answer(id, purpose, payload.as_deref());
            }
        }
    }

    fn info_answer(&mut self, now: Duration, id: NodeId, info: Option<NodeInfo>) {
        let Some(node) = self.nodes.get_mut(&id) else { return };
        node.info.asked = false;
        let waiting = std::mem::take(&mut node.info.waiting);
        let known = info.is_some();
        match info {
            Some(info) => {
                self.log.push(format!("node {id} is {info}"));
                node.info.known = Some(info);
                node.info.sent_at = now;
                self.post_info(now, id, To::All);
            }
            None => {
                let pause = INFO_RETRY.saturating_mul(1 << node.info.failures.min(8)).min(INFO_RETRY_MAX);
                if node.info.failures == 0 {
                    self.log.push(format!("node {id} does not say who it is"));
                }
                node.info.failures += 1;
                node.info.next_try = now + pause;
            }
        }
        for command in waiting {
            self.command_done(command, id, known);
        }
    }

    /// Sends what is known of a node; nothing if that is not known.
    pub(crate) fn post_info(&mut self, now: Duration, id: NodeId, to: To) {
        let time_usec = self.unix_us(now);
        let Some(node) = self.nodes.get(&id) else { return };
        let Some(info) = &node.info.known else { return };
        let data = UAVCAN_NODE_INFO_DATA {
            time_usec,
            uptime_sec: node.status.uptime_s,
            sw_vcs_commit: info.commit.unwrap_or(0),
            name: chars(&info.name),
            hw_version_major: info.hardware.0,
            hw_version_minor: info.hardware.1,
            hw_unique_id: info.unique_id,
            sw_version_major: info.software.0,
            sw_version_minor: info.software.1,
        };
        self.post(to, Class::Info, id.get(), Content::from(MavMessage::UAVCAN_NODE_INFO(data)));
    }

    pub(crate) fn status_content(&self, now: Duration, status: &NodeStatus) -> Content {
        let data = UAVCAN_NODE_STATUS_DATA {
            time_usec: self.unix_us(now),
            uptime_sec: status.uptime_s,
            vendor_specific_status_code: status.vendor_code,
            health: match status.health {
                Health::Ok => UavcanNodeHealth::UAVCAN_NODE_HEALTH_OK,
                Health::Warning => UavcanNodeHealth::UAVCAN_NODE_HEALTH_WARNING,
                Health::Error => UavcanNodeHealth::UAVCAN_NODE_HEALTH_ERROR,
                Health::Critical => UavcanNodeHealth::UAVCAN_NODE_HEALTH_CRITICAL,
            },
            mode: UavcanNodeMode::DEFAULT,
            sub_mode: status.sub_mode,
        };
        Content::Status { data, mode: status.mode.field() }
    }

    /// Keeps a message for a node that may show itself in a moment, as after the start of the bridge.
    fn keep_early(&mut self, now: Duration, asker: Asker, message: &In) {
        let unknown = NodeId::new(message.to.1).is_some_and(|id| !self.nodes.contains_key(&id));
        let wanted = match message.request {
            // A list of all nodes is one of those that come later too.
            Request::ParameterList => unknown || message.to.1 == 0,
            Request::ParameterRead { .. } | Request::ParameterSet { .. } | Request::Command(_) => unknown,
            _ => false,
        };
        let own = message.to.1 == self.settings.component;
        let again = self.early.iter().any(|(_, who, what)| (who, what) == (&asker, message));
        if wanted && !own && !again && self.early.len() < EARLY_MAX {
            self.early.push((now + EARLY_FOR, asker, message.clone()));
        }
    }

    /// A node has shown itself: what was for it before?
    fn early_messages(&mut self, now: Duration, id: NodeId) {
        let of_it = |(_, _, message): &(Duration, Asker, In)| message.to.1 == id.get() || message.to.1 == 0;
        let messages: Vec<(Asker, In)> = self
            .early
            .iter()
            .filter(|early| of_it(early))
            .map(|(_, asker, message)| (*asker, message.clone()))
            .collect();
        self.early.retain(|(_, _, message)| message.to.1 != id.get());
        for (asker, message) in messages {
            self.message(now, asker, In { to: (self.settings.system, id.get()), ..message });
        }
    }

    /// A message from a ground station.
    pub fn message(&mut self, now: Duration, asker: Asker, message: In) {
        let (system, component) = message.to;
        if system != 0 && system != self.settings.system {
            return;
        }
        self.keep_early(now, asker, &message);
        match message.request {
            Request::Heartbeat | Request::Other => {}
            Request::ParameterList => self.parameter_ops(component, || Op::List(asker)),
            Request::ParameterRead { index: Some(index), .. } => {
                self.parameter_ops(component, || Op::ReadIndex(asker, index));
            }
            Request::ParameterRead { index: None, name } => {
                self.parameter_ops(component, || Op::ReadName(asker, name.clone()));
            }
            Request::ParameterSet { name, value, kind } => {
                // One value for all nodes is nobody's wish.
                if component != 0 {
                    self.parameter_ops(component, || Op::Set { asker, name: name.clone(), value, kind });
                }
            }
            Request::Command(command) => self.command(now, asker, component, command),
            Request::Frame(data) => self.frame_from_station(now, asker, &data),
            Request::Filter(data) => self.filter(now, asker, &data),
        }
    }

    /// Somebody new listens: it is greeted, and told who is there.
    pub fn joined(&mut self, now: Duration, peer: PeerId) {
        let heartbeat = self.heartbeat(None);
        self.post(To::One(peer), Class::Answer, self.settings.component, Content::from(heartbeat));
        let online: Vec<NodeId> = self.online().collect();
        for id in online {
            self.post_info(now, id, To::One(peer));
        }
    }

    /// The bus was away and is back: whatever is there now may be something else, whose uptime need not tell.
    pub fn bus_is_back(&mut self) {
        let online: Vec<NodeId> = self.online().collect();
        for id in online {
            self.forget_what_it_said(id);
            self.ask_who_it_is(id);
        }
    }

    /// A ground station has gone.
    pub fn left(&mut self, peer: PeerId) {
        self.subscribers.remove(&peer);
        self.early.retain(|(_, asker, _)| asker.peer != peer);
        self.drop_commands_of(peer);
    }

    pub(crate) fn online(&self) -> impl Iterator<Item = NodeId> {
        self.nodes.iter().filter(|(_, node)| node.online).map(|(id, _)| *id)
    }

    /// The passing of time.
    pub fn poll(&mut self, now: Duration) {
        self.miss_nodes(now);
        self.ask_again(now);
        self.autosave(now);
        if now >= self.next_beat {
            // Beats that were missed are not made up for.
            self.next_beat = if now < self.next_beat + BEAT { self.next_beat + BEAT } else { now + BEAT };
            self.beat(now);
        }
        let before = self.frames.len();
        let failed = self.calls.poll(now, &mut self.frames);
        for answer in failed {
            self.answer(now, answer);
        }
        let sent: Vec<Frame> = self.frames[before..].to_vec();
        for frame in sent {
            self.forward(now, &frame, None);
        }
        self.subscribers.retain(|_, subscriber| subscriber.until > now);
        self.early.retain(|(until, ..)| *until > now);
    }

    /// When [`poll`](Bridge::poll) is needed at the latest.
    pub fn deadline(&self) -> Duration {
        self.calls.deadline().map_or(self.next_beat, |deadline| deadline.min(self.next_beat))
    }

    fn miss_nodes(&mut self, now: Duration) {
        let missed = |node: &Node| node.online && now > node.heard + OFFLINE_AFTER;
        let gone: Vec<NodeId> = self.nodes.iter().filter(|(_, node)| missed(node)).map(|(id, _)| *id).collect();
        for id in gone {
            self.log.push(format!("node {id} is gone: no status for {} s", OFFLINE_AFTER.as_secs()));
            self.post(To::All, Class::Text, id.get(), Content::from(text(&format!("Node {id} is offline"))));
            self.posts.push(Post::Forget { node: id });
            if let Some(node) = self.nodes.get_mut(&id) {
                node.online = false;
            }
        }
    }

    fn ask_again(&mut self, now: Duration) {
        let interval = self.settings.info_interval;
        let online: Vec<NodeId> = self.online().collect();
        for id in online {
            let Some(node) = self.nodes.get_mut(&id) else { continue };
            if node.info.known.is_none() && now >= node.info.next_try {
                self.ask_who_it_is(id);
            } else if node.info.known.is_some() && now >= node.info.sent_at + interval {
                node.info.sent_at = now;
                self.post_info(now, id, To::All);
            }
        }
    }

    fn beat(&mut self, now: Duration) {
        let status = NodeStatus { uptime_s: now.as_secs() as u32, ..NodeStatus::default() };
        let id = types::NODE_STATUS.message_id(STATUS_PRIORITY, self.settings.node).build();
        for data in split(&status.encode(), self.status_id.advance(), 0) {
            self.send(now, Frame::extended(id, &data));
        }
        self.post(To::All, Class::Answer, self.settings.component, Content::from(self.heartbeat(None)));
        let online: Vec<NodeId> = self.online().collect();
        for id in online {
            let heartbeat = self.heartbeat(Some(id));
            self.post(To::All, Class::Heartbeat, id.get(), Content::from(heartbeat));
        }
    }

    /// That of a node, or the bridge's own.
    pub(crate) fn heartbeat(&self, node: Option<NodeId>) -> MavMessage {
        let status = node.and_then(|id| self.nodes.get(&id)).map_or(NodeStatus::default(), |node| node.status);
        let system_status = match (status.health, status.mode) {
            (Health::Critical, _) => MavState::MAV_STATE_EMERGENCY,
            (Health::Error, _) => MavState::MAV_STATE_CRITICAL,
            (_, Mode::Initialization | Mode::SoftwareUpdate) => MavState::MAV_STATE_BOOT,
            (_, Mode::Maintenance) => MavState::MAV_STATE_CALIBRATING,
            (_, Mode::Offline) => MavState::MAV_STATE_POWEROFF,
            _ => MavState::MAV_STATE_ACTIVE,
        };
        MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
            // What is no autopilot must say so.
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            base_mode: MavModeFlag::empty(),
            system_status,
            mavlink_version: MAVLINK_VERSION,
        })
    }

    fn tell_who_we_are(&mut self, now: Duration, to: NodeId, priority: u8, transfer_id: TransferId) {
        let part = |text: &str| text.parse().unwrap_or(0);
        let info = NodeInfo {
            status: NodeStatus { uptime_s: now.as_secs() as u32, ..NodeStatus::default() },
            software: (part(env!("CARGO_PKG_VERSION_MAJOR")), part(env!("CARGO_PKG_VERSION_MINOR"))),
            unique_id: self.settings.unique_id,
            name: NAME.into(),
            ..NodeInfo::default()
        };
        let id = CanId::Service {
            priority,
            service_id: types::GET_NODE_INFO.id as u8,
            request: false,
            destination: to,
            source: self.settings.node,
        };
        for data in split(&info.encode(), transfer_id, types::GET_NODE_INFO.signature.unwrap_or(0)) {
            self.send(now, Frame::extended(id.build(), &data));
        }
    }

    /// Sends one of the bridge's own frames, which those who see the bus through it see too.
    fn send(&mut self, now: Duration, frame: Frame) {
        self.frames.push(frame);
        self.forward(now, &frame, None);
    }

    pub(crate) fn post(&mut self, to: To, class: Class, component: u8, content: Content) {
        self.posts.push(Post::Message { to, class, out: Out { component, content } });
    }

    fn unix_us(&self, now: Duration) -> u64 {
        self.settings.epoch_us + now.as_micros() as u64
    }
}
