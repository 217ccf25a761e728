//! Nodes that are online, and their status: NodeStatus on the bus, UAVCAN_NODE_STATUS and HEARTBEAT
//! on the channels.

use crate::message::{Content, Out};
use crate::node::Node;
use crate::post::{Post, To};
use crate::queue::Class;
use crate::state::State;
use dronecan_host::{Health, Mode, NodeId, NodeStatus, TransferId, types};
use mavlink::dialects::common::{
    HEARTBEAT_DATA, MavAutopilot, MavMessage, MavModeFlag, MavState, MavType,
    UAVCAN_NODE_STATUS_DATA, UavcanNodeHealth, UavcanNodeMode,
};
use std::time::Duration;

/// A node is offline if its last status is older than this.
pub const OFFLINE_AFTER: Duration = Duration::from_secs(5);
/// Time between two warnings about the same conflict of IDs.
pub const CONFLICT_REPEATED_AFTER: Duration = Duration::from_secs(60);
/// Priority of the bridge's statuses, the same as other nodes'.
const STATUS_PRIORITY: u8 = 24;
const MAVLINK_VERSION: u8 = 3;
const OWN_TYPE: MavType = MavType::MAV_TYPE_ONBOARD_CONTROLLER;
/// A component that is not an autopilot must say so.
const OWN_AUTOPILOT: MavAutopilot = MavAutopilot::MAV_AUTOPILOT_INVALID;

/// What a NodeStatus shows about its node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NodeChange {
    /// The node is new, or has returned.
    Appeared,
    Restarted,
    Nothing,
}

impl State {
    /// Stores a node's status.
    pub(crate) fn note_status(
        &mut self,
        now: Duration,
        id: NodeId,
        status: NodeStatus,
        transfer_id: TransferId,
    ) -> NodeChange {
        let known = self
            .nodes
            .entry(id)
            .or_insert_with(|| Node { is_online: false, ..Node::new(status, transfer_id, now) });
        let appeared = !known.is_online;
        // Two nodes with one ID look like one node that restarts each second.
        let is_other = known.other_uptime.is_some_and(|other| other.fits(now, &status))
            && !known.uptime().fits(now, &status);
        let goes_back =
            status.uptime_s < known.status.uptime_s || known.began_anew(now, &status, transfer_id);
        let restarted = goes_back && !is_other;
        if is_other || restarted {
            known.other_uptime = Some(known.uptime());
        }
        let is_new_conflict = is_other
            && known
                .conflict_logged_at
                .is_none_or(|logged_at| now >= logged_at + CONFLICT_REPEATED_AFTER);
        if is_new_conflict {
            known.conflict_logged_at = Some(now);
        }
        known.status = status;
        known.heard = now;
        known.transfer_id = transfer_id;
        known.is_online = true;
        known.statuses += 1;
        if is_new_conflict {
            self.warn(&format!("two nodes have the ID {id}"));
        }
        if appeared {
            self.log.push(format!("node {id} is online: {status}"));
        } else if restarted {
            self.log.push(format!("node {id} has restarted: {status}"));
        }
        if restarted {
            self.say(To::All, id.get(), &format!("Node {id} has restarted"));
        }
        match (appeared, restarted) {
            (_, true) => NodeChange::Restarted,
            (true, false) => NodeChange::Appeared,
            (false, false) => NodeChange::Nothing,
        }
    }

    /// Sends a node's status to the stations.
    pub(crate) fn post_status(&mut self, now: Duration, id: NodeId, status: &NodeStatus) {
        let out = Out { component: id.get(), content: self.status_content(now, status) };
        self.posts.push(Post::Status { node: id, out });
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

    /// Finds the nodes that have become offline.
    pub(crate) fn check_offline_nodes(&mut self, now: Duration) {
        let missed = |node: &Node| node.is_online && now > node.heard + OFFLINE_AFTER;
        let gone: Vec<NodeId> =
            self.nodes.iter().filter(|(_, node)| missed(node)).map(|(id, _)| *id).collect();
        for id in gone {
            self.log
                .push(format!("node {id} is offline: no status for {} s", OFFLINE_AFTER.as_secs()));
            self.say(To::All, id.get(), &format!("Node {id} is offline"));
            self.posts.push(Post::Forget { node: id });
            if let Some(node) = self.nodes.get_mut(&id) {
                node.is_online = false;
            }
        }
    }

    /// Sends the bridge's NodeStatus and all heartbeats. Due once a second.
    pub(crate) fn send_heartbeats(&mut self, now: Duration, transfer_id: TransferId) {
        let status = NodeStatus { uptime_s: now.as_secs() as u32, ..NodeStatus::default() };
        let id = types::NODE_STATUS.message_id(STATUS_PRIORITY, self.settings.node);
        self.send(id, &status.encode(), transfer_id);
        let own = self.settings.component;
        self.post(To::All, Class::Answer, own, self.heartbeat(None));
        // A second heartbeat of that component would contradict its own.
        let speaking = |id: &NodeId| id.get() != own && !self.is_other_component(id.get());
        let nodes: Vec<NodeId> = self.online_nodes().filter(speaking).collect();
        for id in nodes {
            self.post(To::All, Class::Heartbeat, id.get(), self.heartbeat(Some(id)));
        }
    }

    /// Notes that another program has a component of this system. A ground station would take its
    /// heartbeats and those of the node with the same ID for the same component.
    pub(crate) fn note_component(
        &mut self,
        (system, component): (u8, u8),
        kind: u8,
        autopilot: u8,
    ) {
        // A router may connect another channel of the bridge to this one.
        let is_like_ours = (kind, autopilot) == (OWN_TYPE as u8, OWN_AUTOPILOT as u8);
        if system != self.settings.system || is_like_ours || !self.real_components.insert(component)
        {
            return;
        }
        if component == self.settings.component {
            self.warn(&format!("another component has the ID {component}: --component"));
        } else if NodeId::new(component).is_some() {
            self.log.push(format!(
                "component {component} sends its own heartbeat: the bridge sends none for node \
                 {component}"
            ));
        }
    }

    /// The heartbeat of a node, or the bridge's own.
    pub(crate) fn heartbeat(&self, node: Option<NodeId>) -> MavMessage {
        let status = node
            .and_then(|id| self.nodes.get(&id))
            .map_or(NodeStatus::default(), |node| node.status);
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
            mavtype: OWN_TYPE,
            autopilot: OWN_AUTOPILOT,
            base_mode: MavModeFlag::empty(),
            system_status,
            mavlink_version: MAVLINK_VERSION,
        })
    }
}
