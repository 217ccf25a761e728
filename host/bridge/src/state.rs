//! The state of the bridge, and what it has to send. The parts of the bridge use it;
//! [`crate::core`] owns it.

use crate::calls::Calls;
use crate::message::{Content, Out, text, warning};
use crate::node::Node;
use crate::post::{Asker, PeerId, Post, To};
use crate::queue::Class;
use crate::task::Purpose;
use crate::tunnel;
use dronecan_host::{CanId, Frame, NodeId, TransferId, frames};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Identity of the bridge, and its intervals.
#[derive(Clone, Debug)]
pub struct Settings {
    /// MAVLink system ID of the bridge and all nodes.
    pub system: u8,
    /// MAVLink component ID of the bridge.
    pub component: u8,
    /// The bridge's node ID on the bus.
    pub node: NodeId,
    pub unique_id: [u8; 16],
    /// Time between two UAVCAN_NODE_INFO of a node.
    pub info_interval: Duration,
    /// If set, the bridge saves a node's parameters this long after the last was set.
    pub autosave: Option<Duration>,
    pub rights: Rights,
    pub tunnels: Vec<tunnel::Spec>,
    /// Nodes that are MAVLink components themselves, such as an autopilot.
    pub hidden: BTreeSet<NodeId>,
    /// Unix time at time 0, in microseconds.
    pub epoch_us: u64,
}

#[cfg(test)]
impl Settings {
    /// Those of most tests: component and node 126 of system 1, which allows everything.
    pub fn of_tests() -> Settings {
        Settings {
            system: 1,
            component: 126,
            node: NodeId::new(126).unwrap(),
            unique_id: [7; 16],
            info_interval: Duration::from_secs(60),
            autosave: None,
            rights: Rights { change: true, can: true },
            tunnels: Vec::new(),
            hidden: BTreeSet::new(),
            epoch_us: 1_000_000_000,
        }
    }
}

/// What ground stations may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rights {
    /// Set, save, erase, restart, and send frames.
    pub change: bool,
    /// Receive the frames of the bus, and send frames.
    pub can: bool,
}

/// The nodes, the requests in progress, and the output that the caller takes.
pub struct State {
    pub settings: Settings,
    /// Every node that has sent a status.
    pub nodes: BTreeMap<NodeId, Node>,
    /// Components of the system, except the bridge's, that have sent messages on a channel.
    pub real_components: BTreeSet<u8>,
    pub calls: Calls<Purpose>,
    /// Frames for the bus, with the ground station that a frame comes from; `None` for the
    /// bridge's own.
    pub outgoing: Vec<(Frame, Option<PeerId>)>,
    pub posts: Vec<Post>,
    /// Lines for the log.
    pub log: Vec<String>,
}

impl State {
    pub fn new(settings: Settings) -> State {
        State {
            calls: Calls::new(settings.node),
            settings,
            nodes: BTreeMap::new(),
            real_components: BTreeSet::new(),
            outgoing: Vec::new(),
            posts: Vec::new(),
            log: Vec::new(),
        }
    }

    pub fn online_nodes(&self) -> impl Iterator<Item = NodeId> {
        self.nodes.iter().filter(|(_, node)| node.is_online).map(|(id, _)| *id)
    }

    /// True if this component is not the bridge's: the bridge sends no heartbeat for it and answers
    /// no message to it.
    pub fn is_other_component(&self, component: u8) -> bool {
        let is_hidden = NodeId::new(component).is_some_and(|id| self.settings.hidden.contains(&id));
        is_hidden || self.real_components.contains(&component)
    }

    pub fn post(&mut self, to: To, class: Class, component: u8, content: impl Into<Content>) {
        let out = Out { component, content: content.into() };
        self.posts.push(Post::Message { to, class, out });
    }

    /// Answers a station.
    pub fn answer(&mut self, asker: Asker, component: u8, content: impl Into<Content>) {
        self.post(To::One(asker.peer), Class::Answer, component, content);
    }

    /// Sends a STATUSTEXT.
    pub fn say(&mut self, to: To, component: u8, words: &str) {
        self.post(to, Class::Text, component, text(words));
    }

    /// Sends a transfer on the bus.
    pub fn send(&mut self, id: CanId, payload: &[u8], transfer_id: TransferId) {
        let frames = frames(id, payload, transfer_id).into_iter();
        self.outgoing.extend(frames.map(|frame| (frame, None)));
    }

    /// Reports a problem to all ground stations and in the log.
    pub fn warn(&mut self, words: &str) {
        self.log.push(words.to_owned());
        let mut chars = words.chars();
        let sentence: String =
            chars.next().into_iter().flat_map(char::to_uppercase).chain(chars).collect();
        self.post(To::All, Class::Text, self.settings.component, warning(&sentence));
    }

    /// Unix time in microseconds, for the messages that have it.
    pub fn unix_us(&self, now: Duration) -> u64 {
        self.settings.epoch_us + now.as_micros() as u64
    }
}
