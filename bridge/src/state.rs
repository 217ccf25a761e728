//! What the bridge knows, and what it has to send. The parts of the bridge work on this; [`crate::core`] holds it.

use crate::calls::Calls;
use crate::message::{Content, Out, warning};
use crate::node::Node;
use crate::post::{PeerId, Post, To};
use crate::queue::Class;
use crate::task::Purpose;
use crate::tunnel;
use dronecan_host::{Frame, NodeId};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Identity of the bridge, and its intervals.
#[derive(Clone, Debug)]
pub struct Settings {
    /// MAVLink system, for the bridge and all nodes.
    pub system: u8,
    /// The bridge's MAVLink component.
    pub component: u8,
    /// The bridge's node ID on the bus.
    pub node: NodeId,
    pub unique_id: [u8; 16],
    /// Time between two UAVCAN_NODE_INFO of a node.
    pub info_interval: Duration,
    /// Save a node's parameters by itself, that long after the last was set.
    pub autosave: Option<Duration>,
    pub rights: Rights,
    pub tunnels: Vec<tunnel::Spec>,
    /// Nodes that are components of the system by themselves, as an autopilot is.
    pub hidden: BTreeSet<NodeId>,
    /// Unix time at time 0, in microseconds.
    pub epoch_us: u64,
}

/// What ground stations may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rights {
    /// Set, save, erase, restart, and send frames.
    pub change: bool,
    /// See the bus, and send frames.
    pub can: bool,
}

/// The nodes, the requests that are under way, and what waits to be taken away.
pub struct State {
    pub settings: Settings,
    /// Every node that has been heard.
    pub nodes: BTreeMap<NodeId, Node>,
    /// Components of the system that have been heard on a channel and are not the bridge's.
    pub real_components: BTreeSet<u8>,
    pub calls: Calls<Purpose>,
    /// Frames for the bus, with the ground station that a frame comes from; `None` for the bridge's own.
    pub outgoing: Vec<(Frame, Option<PeerId>)>,
    pub posts: Vec<Post>,
    /// Lines for people.
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

    pub fn online(&self) -> impl Iterator<Item = NodeId> {
        self.nodes.iter().filter(|(_, node)| node.online).map(|(id, _)| *id)
    }

    /// True if that component is not the bridge's: the bridge sends no heartbeat for it, and answers no message to it.
    pub fn speaks_for_itself(&self, component: u8) -> bool {
        let is_hidden = NodeId::new(component).is_some_and(|id| self.settings.hidden.contains(&id));
        is_hidden || self.real_components.contains(&component)
    }

    pub fn post(&mut self, to: To, class: Class, component: u8, content: Content) {
        self.posts.push(Post::Message { to, class, out: Out { component, content } });
    }

    /// Reports a problem to all ground stations and the log.
    pub fn warn(&mut self, words: &str) {
        self.log.push(words.to_owned());
        let mut chars = words.chars();
        let sentence: String = chars.next().into_iter().flat_map(char::to_uppercase).chain(chars).collect();
        self.post(To::All, Class::Text, self.settings.component, Content::from(warning(&sentence)));
    }

    /// Unix time in microseconds, for the messages that carry it.
    pub fn unix_us(&self, now: Duration) -> u64 {
        self.settings.epoch_us + now.as_micros() as u64
    }
}
