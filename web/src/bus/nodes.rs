//! The nodes of the real bus, by their NodeStatus and GetNodeInfo.

use std::collections::BTreeMap;
use std::time::Duration;

use bench::dronecan::text::hex;
use bench::dronecan::{Decoded, Message, NodeId, NodeInfo, NodeStatus, draft};
use bench::vendor_code;
use node_tools::update::search::{TAKES_NO_UPDATES, is_of_this_project};
use serde_json::{Value as Json, json};

use crate::traffic::shown;

/// Longest name (GetNodeInfo).
const NAME_MAX: usize = 80;
/// A node is asked for its information so often, and again when it has restarted.
const ATTEMPTS: u32 = 3;
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);
/// A node that was not heard for so long is not asked.
const GONE_AFTER: Duration = Duration::from_secs(3);
/// Nodes that are asked at once.
const AT_ONCE: usize = 4;

/// What is known of a node.
struct Known {
    status: NodeStatus,
    /// Time of its last status.
    at: Duration,
    /// True if it speaks the draft, whose services the page has not.
    is_draft: bool,
    info: Option<NodeInfo>,
    /// Requests for its information that may still be sent, and the time of the next.
    attempts: u32,
    ask_at: Duration,
}

/// The nodes that have sent NodeStatus.
#[derive(Default)]
pub struct Nodes(BTreeMap<NodeId, Known>);

impl Nodes {
    /// Handles a transfer on the bus.
    pub fn take(&mut self, decoded: &Decoded, now: Duration) {
        let Some(node) = decoded.source() else { return };
        match decoded {
            Decoded::V0(_, Message::NodeStatus(status)) => {
                self.take_status(node, *status, false, now);
            }
            Decoded::Draft(_, draft::Message::NodeStatus(status)) => {
                self.take_status(node, (*status).into(), true, now);
            }
            // An answer to anybody.
            Decoded::V0(_, Message::NodeInfo(info)) => {
                if let Some(known) = self.0.get_mut(&node) {
                    known.info = Some((**info).clone());
                    known.attempts = 0;
                }
            }
            _ => {}
        }
    }

    fn take_status(&mut self, node: NodeId, status: NodeStatus, is_draft: bool, now: Duration) {
        let known = self.0.entry(node).or_insert(Known {
            status,
            at: now,
            is_draft,
            info: None,
            attempts: ATTEMPTS,
            ask_at: now,
        });
        if status.uptime_s < known.status.uptime_s {
            (known.attempts, known.ask_at) = (ATTEMPTS, now);
        }
        (known.status, known.at, known.is_draft) = (status, now, is_draft);
    }

    /// The nodes to ask for their information now. Their next request is due later.
    pub fn take_due(&mut self, now: Duration) -> Vec<NodeId> {
        let due = self.0.iter_mut().filter(|(_, known)| {
            !known.is_draft
                && known.attempts > 0
                && now >= known.ask_at
                && now < known.at + GONE_AFTER
        });
        due.take(AT_ONCE)
            .map(|(node, known)| {
                known.attempts -= 1;
                known.ask_at = now + ANSWER_TIMEOUT;
                *node
            })
            .collect()
    }

    /// The IDs of the nodes.
    pub fn ids(&self) -> impl Iterator<Item = NodeId> {
        self.0.keys().copied()
    }

    /// What a node has told of itself.
    pub fn info(&self, node: NodeId) -> Option<&NodeInfo> {
        self.0.get(&node)?.info.as_ref()
    }

    /// Asks a node again.
    pub fn ask_again(&mut self, node: NodeId, now: Duration) {
        if let Some(known) = self.0.get_mut(&node) {
            (known.attempts, known.ask_at) = (ATTEMPTS, now);
        }
    }

    /// What the page shows, a JSON array.
    pub fn json(&self, now: Duration) -> Json {
        self.0.iter().map(|(node, known)| known.json(*node, now)).collect()
    }
}

impl Known {
    fn json(&self, node: NodeId, now: Duration) -> Json {
        let status = self.status;
        let info = self.info.as_ref();
        let version = |(major, minor)| format!("{major}.{minor}");
        let is_ours = info.is_some_and(is_of_this_project);
        let conditions =
            if is_ours { vendor_code::conditions(status.vendor_code) } else { Vec::new() };
        let takes_none = info.is_some_and(|info| info.hardware.0 & TAKES_NO_UPDATES != 0);
        json!({
            "id": node.get(),
            "name": info.map(|info| shown(&info.name(), NAME_MAX)),
            "dialect": if self.is_draft { "draft" } else { "v0" },
            "is_ours": is_ours,
            "health": status.health.to_string(),
            "mode": status.mode.to_string(),
            "uptime_s": status.uptime_s,
            "vendor_code": status.vendor_code,
            "conditions": conditions,
            "silent_s": now.saturating_sub(self.at).as_secs_f64(),
            "software": info.map(|info| version(info.software)),
            "hardware": info.map(|info| version(info.hardware)),
            "takes_updates": !(is_ours && takes_none),
            "unique_id": info.map(|info| hex(&info.unique_id)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench::dronecan::{CanId, Health, Transfer, TransferId};

    fn id(id: u8) -> NodeId {
        NodeId::new(id).unwrap()
    }

    fn seconds(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    fn decoded(node: u8, message: Message) -> Decoded {
        let id = CanId::Message { priority: 20, type_id: 341, source: id(node) };
        let transfer =
            Transfer { id, transfer_id: TransferId::new(0), payload: Vec::new(), frames: 1 };
        Decoded::V0(transfer, message)
    }

    fn status(node: u8, uptime_s: u32) -> Decoded {
        let status = NodeStatus { uptime_s, health: Health::Warning, ..NodeStatus::default() };
        decoded(node, Message::NodeStatus(status))
    }

    #[test]
    fn a_node_is_asked_three_times_and_again_after_a_restart() {
        let mut nodes = Nodes::default();
        nodes.take(&status(42, 5), seconds(0));
        let asked = |nodes: &mut Nodes, from: u64| {
            (from..from + 3).filter(|now| nodes.take_due(seconds(*now)) == [id(42)]).count()
        };
        assert_eq!(asked(&mut nodes, 0), 3);
        nodes.take(&status(42, 8), seconds(3));
        assert_eq!(asked(&mut nodes, 3), 0);
        nodes.take(&status(42, 0), seconds(6));
        assert_eq!(asked(&mut nodes, 6), 3);
    }

    #[test]
    fn a_node_that_answered_or_is_gone_is_not_asked() {
        let mut nodes = Nodes::default();
        nodes.take(&status(42, 5), seconds(0));
        assert!(nodes.take_due(seconds(3)).is_empty());
        nodes.take(&decoded(42, Message::NodeInfo(Box::default())), seconds(0));
        assert!(nodes.take_due(seconds(0)).is_empty());
    }

    /// Bit 7 of the major hardware version has this meaning for this project's nodes only.
    #[test]
    fn a_node_of_this_project_tells_if_it_takes_updates() {
        let mut nodes = Nodes::default();
        for (name, hardware, takes) in [
            ("org.dronecan.servo328", (2, 0), true),
            ("org.dronecan.servo328", (130, 0), false),
            ("org.example.esc", (130, 0), true),
        ] {
            nodes.take(&status(42, 5), seconds(0));
            let info = NodeInfo { name: name.into(), hardware, ..NodeInfo::default() };
            nodes.take(&decoded(42, Message::NodeInfo(Box::new(info))), seconds(0));
            assert_eq!(nodes.json(seconds(1))[0]["takes_updates"], takes, "{name} {hardware:?}");
        }
    }

    /// A name with an escape sequence and HTML: the first is made visible, and the page shows the
    /// second as text.
    #[test]
    fn the_name_of_a_hostile_node_is_cut_and_has_no_control_characters() {
        let mut nodes = Nodes::default();
        nodes.take(&status(42, 5), seconds(0));
        let name = [b"\x1b[2J<img src=x onerror=alert(1)>".to_vec(), vec![b'a'; 400]].concat();
        let info = NodeInfo { name, ..NodeInfo::default() };
        nodes.take(&decoded(42, Message::NodeInfo(Box::new(info))), seconds(0));
        let nodes = nodes.json(seconds(1));
        let name = nodes[0]["name"].as_str().unwrap();
        assert!(name.starts_with("\\x1b[2J<img src=x onerror=alert(1)>aaa"), "{name}");
        assert_eq!(name.chars().count(), NAME_MAX + 1);
        assert_eq!((&nodes[0]["health"], &nodes[0]["silent_s"]), (&json!("WARNING"), &json!(1.0)));
    }
}
