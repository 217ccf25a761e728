//! Updates several nodes at the same time, so that none waits for one that is slow or does not end.

use std::collections::VecDeque;
use std::rc::Rc;
use std::time::Duration;

use dronecan_host::{Message, NodeId, Transfer};

use crate::update::file::FirmwareFile;
use crate::update::heard::Heard;
use crate::update::search::Candidate;
use crate::update::session::{Action, Outcome, Session};

/// Nodes that are updated at the same time. One that reads takes up to a quarter of a bus of
/// 1 Mbit/s.
const AT_A_TIME: usize = 4;

/// The updates of some nodes.
pub struct Fleet {
    own_id: NodeId,
    waiting: VecDeque<(Candidate, Rc<FirmwareFile>)>,
    running: Vec<Session>,
}

/// What is due for a node.
#[derive(Clone, Debug, PartialEq)]
pub enum Due {
    Request(Message),
    /// Its update has ended.
    End(Outcome),
}

impl Fleet {
    /// No updates. `own_id` is the ID of this program.
    pub fn new(own_id: NodeId) -> Fleet {
        Fleet { own_id, waiting: VecDeque::new(), running: Vec::new() }
    }

    /// Updates a node, now or after others.
    pub fn add(&mut self, candidate: Candidate, file: Rc<FirmwareFile>, now: Duration) {
        self.waiting.push_back((candidate, file));
        self.start(now);
    }

    /// True if no update runs or waits.
    pub fn is_done(&self) -> bool {
        self.running.is_empty() && self.waiting.is_empty()
    }

    /// The updates that run.
    pub fn running(&self) -> &[Session] {
        &self.running
    }

    /// The nodes whose updates have not begun.
    pub fn waiting(&self) -> impl Iterator<Item = NodeId> {
        self.waiting.iter().map(|(candidate, _)| candidate.id)
    }

    /// Ends the update of a node before its end. Returns it if it runs.
    pub fn stop(&mut self, node: NodeId, now: Duration) -> Option<Session> {
        self.waiting.retain(|(candidate, _)| candidate.id != node);
        let at = self.running.iter().position(|session| session.node == node)?;
        let stopped = self.running.remove(at);
        self.start(now);
        Some(stopped)
    }

    /// Handles a transfer. Returns the payload of the response if it is a request of file.Read to
    /// this program.
    pub fn take(&mut self, transfer: &Transfer, now: Duration, heard: &Heard) -> Option<Vec<u8>> {
        self.running.iter_mut().find_map(|session| session.take(transfer, now, heard))
    }

    /// Returns what is due, by node.
    pub fn poll(&mut self, now: Duration) -> Vec<(NodeId, Due)> {
        let mut due = Vec::new();
        self.running.retain_mut(|session| {
            match session.poll(now) {
                Some(Action::Request(message)) => due.push((session.node, Due::Request(message))),
                Some(Action::End(outcome)) => {
                    due.push((session.node, Due::End(outcome)));
                    return false;
                }
                None => {}
            }
            true
        });
        self.start(now);
        due
    }

    fn start(&mut self, now: Duration) {
        while self.running.len() < AT_A_TIME
            && let Some((Candidate { id, info }, file)) = self.waiting.pop_front()
        {
            self.running.push(Session::new(id, info.software, file, self.own_id, now));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::update::file::tests::{file_of, id};
    use dronecan_host::NodeInfo;

    #[test]
    fn four_nodes_are_updated_at_a_time_and_the_next_begins_when_one_ends() {
        let (file, now) = (Rc::new(file_of(600)), Duration::ZERO);
        let mut fleet = Fleet::new(id(126));
        for node in 1..=6 {
            let candidate = Candidate { id: id(node), info: NodeInfo::default() };
            fleet.add(candidate, Rc::clone(&file), now);
        }
        let running = |fleet: &Fleet| -> Vec<u8> {
            fleet.running().iter().map(|session| session.node.get()).collect()
        };
        assert_eq!(running(&fleet), [1, 2, 3, 4]);
        assert_eq!(fleet.waiting().collect::<Vec<_>>(), [id(5), id(6)]);
        assert_eq!(fleet.poll(now).len(), 4);
        assert!(fleet.stop(id(6), now).is_none());
        assert_eq!(fleet.stop(id(2), now).map(|session| session.sent()), Some(0));
        assert_eq!(running(&fleet), [1, 3, 4, 5]);
        let silent = Duration::from_secs(60);
        for seconds in 1..=6 {
            fleet.poll(Duration::from_secs(seconds));
        }
        assert!(fleet.poll(silent).is_empty() && fleet.is_done());
    }
}
