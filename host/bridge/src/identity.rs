//! Information of nodes: GetNodeInfo on the bus, UAVCAN_NODE_INFO on the channels; and the bridge's
//! own answer to GetNodeInfo.
//!
//! The bridge requests the information when a node appears, returns or restarts. Without an answer
//! it repeats the request, less and less often.

use crate::message::chars;
use crate::post::{PeerId, To};
use crate::queue::Class;
use crate::state::State;
use crate::task::Purpose;
use dronecan_host::{CanId, Message, NodeId, NodeInfo, NodeStatus, TransferId, types};
use mavlink::dialects::common::{MavMessage, UAVCAN_NODE_INFO_DATA};
use std::time::Duration;

/// Time until the request is repeated to a node that does not answer. It doubles each time.
const INFO_RETRY: Duration = Duration::from_secs(2);
const INFO_RETRY_MAX: Duration = Duration::from_secs(60);
/// The bridge's node name on the bus.
pub const NAME: &str = "org.dronecan.mavlink_bridge";

/// Major and minor version of the bridge.
pub fn own_version() -> (u8, u8) {
    let number = |digits: &str| digits.parse().expect("cargo writes numbers");
    (number(env!("CARGO_PKG_VERSION_MAJOR")), number(env!("CARGO_PKG_VERSION_MINOR")))
}

impl State {
    pub(crate) fn request_info(&mut self, id: NodeId) {
        if let Some(node) = self.nodes.get_mut(&id)
            && !node.info.is_requested
        {
            node.info.is_requested = true;
            self.calls.ask(id, &Message::NodeInfoRequest, Purpose::Info);
        }
    }

    /// Handles the answer to GetNodeInfo; `None` if there was none. Returns the commands that
    /// waited for it.
    pub(crate) fn info_answer(
        &mut self,
        now: Duration,
        id: NodeId,
        info: Option<NodeInfo>,
    ) -> Vec<u32> {
        let Some(node) = self.nodes.get_mut(&id) else { return Vec::new() };
        node.info.is_requested = false;
        let waiting = std::mem::take(&mut node.info.waiting);
        match info {
            Some(info) => {
                self.log.push(format!("node {id} is {info}"));
                node.info.known = Some(info);
                node.info.sent_at = now;
                self.post_info(now, id, To::All);
            }
            None => {
                let pause =
                    INFO_RETRY.saturating_mul(1 << node.info.failures.min(8)).min(INFO_RETRY_MAX);
                if node.info.failures == 0 {
                    self.log.push(format!("node {id} does not answer GetNodeInfo"));
                }
                node.info.failures += 1;
                node.info.next_try = now + pause;
            }
        }
        waiting
    }

    /// Sends a node's information, if it is known.
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
        self.post(to, Class::Info, id.get(), MavMessage::UAVCAN_NODE_INFO(data));
    }

    /// Sends GetNodeInfo to nodes without information, and repeats the UAVCAN_NODE_INFO of the
    /// others.
    pub(crate) fn repeat_infos(&mut self, now: Duration) {
        let interval = self.settings.info_interval;
        let online: Vec<NodeId> = self.online_nodes().collect();
        for id in online {
            let Some(node) = self.nodes.get_mut(&id) else { continue };
            if node.info.known.is_none() && now >= node.info.next_try {
                self.request_info(id);
            } else if node.info.known.is_some() && now >= node.info.sent_at + interval {
                node.info.sent_at = now;
                self.post_info(now, id, To::All);
            }
        }
    }

    /// Sends the known nodes to a new ground station.
    pub(crate) fn send_all_infos(&mut self, now: Duration, peer: PeerId) {
        let online: Vec<NodeId> = self.online_nodes().collect();
        for id in online {
            self.post_info(now, id, To::One(peer));
        }
    }

    /// Answers GetNodeInfo.
    pub(crate) fn answer_node_info(
        &mut self,
        now: Duration,
        to: NodeId,
        priority: u8,
        transfer_id: TransferId,
    ) {
        let info = NodeInfo {
            status: NodeStatus { uptime_s: now.as_secs() as u32, ..NodeStatus::default() },
            software: own_version(),
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
        self.send(id, &info.encode(), transfer_id);
    }
}
