//! What the bridge knows, and what it has to send. The parts of the bridge work on this; [`crate::core`] holds it.

use crate::calls::Calls;
use crate::message::{Content, Out};
use crate::node::Node;
use crate::post::{PeerId, Post, To};
use crate::queue::Class;
use crate::task::Purpose;
use dronecan_host::{Frame, NodeId};
use std::collections::BTreeMap;
use std::time::Duration;

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

/// The nodes, the requests that are under way, and what waits to be taken away.
pub struct State {
    pub settings: Settings,
    /// Every node that has been heard.
    pub nodes: BTreeMap<NodeId, Node>,
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
            outgoing: Vec::new(),
            posts: Vec::new(),
            log: Vec::new(),
        }
    }

    pub fn online(&self) -> impl Iterator<Item = NodeId> {
        self.nodes.iter().filter(|(_, node)| node.online).map(|(id, _)| *id)
    }

    pub fn post(&mut self, to: To, class: Class, component: u8, content: Content) {
        self.posts.push(Post::Message { to, class, out: Out { component, content } });
    }

    /// Unix time in microseconds, for the messages that carry it.
    pub fn unix_us(&self, now: Duration) -> u64 {
        self.settings.epoch_us + now.as_micros() as u64
    }
}
