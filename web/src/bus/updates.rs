//! The updates of nodes on the real bus: what waits, what runs, and how each has ended.

use std::collections::BTreeMap;
use std::rc::Rc;
use std::time::Duration;

use bench::dronecan::{NodeId, Transfer};
use node_tools::update::file::FirmwareFile;
use node_tools::update::fleet::{Due, Fleet};
use node_tools::update::heard::Heard;
use node_tools::update::search::{self, Search};
use node_tools::update::session::Outcome;
use node_tools::update::tool::Tool;
use serde_json::{Value as Json, json};

use super::MESSAGE_MAX;
use crate::traffic::shown;

/// Time in which a node that is to be updated must answer GetNodeInfo.
const INFO_TIMEOUT: Duration = Duration::from_secs(4);

/// An update that waits until the node has told its information.
struct Asked {
    file: Rc<FirmwareFile>,
    /// `None` until the page has a node ID.
    since: Option<Duration>,
}

/// The result of an update, in words.
struct Ended {
    is_updated: bool,
    text: String,
}

/// The updates. A node has one at a time.
#[derive(Default)]
pub struct Updates {
    /// `None` until the page has a node ID.
    fleet: Option<Fleet>,
    asked: BTreeMap<NodeId, Asked>,
    ended: BTreeMap<NodeId, Ended>,
}

impl Updates {
    /// The page has taken a node ID.
    pub fn join(&mut self, own_id: NodeId) {
        self.fleet = Some(Fleet::new(own_id));
    }

    /// Updates a node as soon as its information is known.
    ///
    /// # Errors
    /// If the node is in an update.
    pub fn ask(&mut self, node: NodeId, file: FirmwareFile) -> Result<(), String> {
        if self.includes(node) {
            return Err(format!("node {node} is already in an update"));
        }
        self.ended.remove(&node);
        self.asked.insert(node, Asked { file: Rc::new(file), since: None });
        Ok(())
    }

    fn includes(&self, node: NodeId) -> bool {
        let in_fleet = self.fleet.as_ref().is_some_and(|fleet| {
            fleet.running().iter().any(|session| session.node == node)
                || fleet.waiting().any(|waiting| waiting == node)
        });
        in_fleet || self.asked.contains_key(&node)
    }

    /// Stops the update of a node.
    pub fn stop(&mut self, node: NodeId, now: Duration) {
        if self.includes(node) {
            self.asked.remove(&node);
            let stopped = self.fleet.as_mut().and_then(|fleet| fleet.stop(node, now));
            let state = stopped.map_or("was not updated", |session| session.state_if_ended_now());
            self.end(node, false, state);
        }
    }

    /// Stops all updates, because the page has no node ID any more.
    pub fn stop_all(&mut self) {
        if let Some(fleet) = self.fleet.take() {
            for session in fleet.running() {
                self.end(session.node, false, session.state_if_ended_now());
            }
            for node in fleet.waiting() {
                self.end(node, false, "was not updated");
            }
        }
        for node in std::mem::take(&mut self.asked).into_keys() {
            self.end(node, false, "was not updated");
        }
    }

    fn end(&mut self, node: NodeId, is_updated: bool, text: &str) {
        self.ended.insert(node, Ended { is_updated, text: shown(text, MESSAGE_MAX) });
    }

    /// Handles a transfer. Returns the payload of the response if it is a request of file.Read to
    /// this page.
    pub fn take(&mut self, transfer: &Transfer, now: Duration, heard: &Heard) -> Option<Vec<u8>> {
        self.fleet.as_mut()?.take(transfer, now, heard)
    }

    /// Sends what is due. Returns the nodes whose updates have ended.
    pub fn poll(&mut self, tool: &mut Tool, search: &Search, now: Duration) -> Vec<NodeId> {
        if tool.id().is_some() {
            self.begin(tool, search, now);
        }
        let Some(fleet) = &mut self.fleet else { return Vec::new() };
        let mut ended = Vec::new();
        for (node, due) in fleet.poll(now) {
            match due {
                Due::Request(message) => {
                    tool.request(&message, node);
                }
                Due::End(outcome) => ended.push((node, outcome)),
            }
        }
        for (node, outcome) in &ended {
            match outcome {
                Outcome::Updated(text) => self.end(*node, true, text),
                Outcome::Failed(text) => self.end(*node, false, text),
            }
        }
        ended.into_iter().map(|(node, _)| node).collect()
    }

    /// Begins the updates of nodes whose information is known, or says why not.
    fn begin(&mut self, tool: &mut Tool, search: &Search, now: Duration) {
        let unknown = search.unknown();
        let mut due = Vec::new();
        for (node, asked) in &mut self.asked {
            let since = *asked.since.get_or_insert(now);
            if !unknown.contains(node) || now >= since + INFO_TIMEOUT {
                due.push(*node);
            }
        }
        for node in due {
            let Some(Asked { file, .. }) = self.asked.remove(&node) else { continue };
            match search.choose(search::Nodes::One(node), &file, tool.heard(), now).nodes {
                Ok(candidates) => {
                    self.take_left_id(tool, search, now);
                    let Some(fleet) = &mut self.fleet else { return };
                    for candidate in candidates {
                        fleet.add(candidate, Rc::clone(&file), now);
                    }
                }
                Err(why) => self.end(node, false, &why),
            }
        }
    }

    /// Takes the node ID that a node asks for the rest of a file, if nobody has it and no update
    /// needs the present one.
    fn take_left_id(&mut self, tool: &mut Tool, search: &Search, now: Duration) {
        let is_free = self.fleet.as_ref().is_none_or(Fleet::is_done);
        if is_free
            && let Some(left) = search.left_server(tool.heard(), now)
            && Some(left) != tool.id()
            && let Ok(id) = tool.take_id(None, Some(left))
        {
            self.join(id);
        }
    }

    /// What the page shows, a JSON array.
    pub fn json(&self) -> Json {
        let waits =
            |node: NodeId, text: &str| json!({"node": node.get(), "runs": true, "text": text});
        let mut updates: BTreeMap<NodeId, Json> = BTreeMap::new();
        for (node, Ended { is_updated, text }) in &self.ended {
            let update = json!({
                "node": node.get(), "runs": false, "is_updated": is_updated, "text": text,
            });
            updates.insert(*node, update);
        }
        for node in self.asked.keys() {
            updates.insert(*node, waits(*node, "asking what it is"));
        }
        if let Some(fleet) = &self.fleet {
            updates.extend(fleet.waiting().map(|node| (node, waits(node, "waiting for others"))));
            updates.extend(fleet.running().iter().map(|session| {
                let update = json!({
                    "node": session.node.get(), "runs": true, "text": session.stage(),
                    "sent": session.sent(), "total": session.file_len(),
                });
                (session.node, update)
            }));
        }
        updates.into_values().collect()
    }
}
