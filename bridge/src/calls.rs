//! Requests to nodes: several at a time, repeated when nothing comes back, given up in bounded time.
//!
//! Each node has a queue, and a window of requests that may be on their way to it at once. A request that is not answered
//! halves the window, for a small node may have no room for more; answers widen it again. Each attempt has a transfer ID of
//! its own, so that a late answer to an earlier one is not taken for that of another request.

use dronecan_host::{CanId, DataType, Frame, NodeId, Transfer, TransferId, split};
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::time::Duration;

/// On their way to one node at once: what the DroneCAN GUI Tool does.
const WINDOW: usize = 5;
/// Lowest but one: parameters can wait for everything else on the bus.
const PRIORITY: u8 = 30;
/// Waiting for one node; beyond that a request fails at once.
const QUEUE_LIMIT: usize = 512;

/// How long to wait for an answer, and how often to ask.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    pub timeout: Duration,
    pub attempts: u32,
}

impl Patience {
    pub const fn new(timeout_ms: u64, attempts: u32) -> Patience {
        Patience { timeout: Duration::from_millis(timeout_ms), attempts }
    }
}

/// For ExecuteOpcode. Long: a small node writes all of its memory.
pub const OPCODE_PATIENCE: Patience = Patience::new(1500, 2);

/// A request with what it is for.
#[derive(Clone, Debug)]
struct Call<P> {
    service: DataType,
    payload: Vec<u8>,
    patience: Patience,
    attempts_left: u32,
    purpose: P,
}

struct Flight<P> {
    call: Call<P>,
    transfer_id: TransferId,
    deadline: Duration,
}

struct Line<P> {
    waiting: VecDeque<Call<P>>,
    flying: Vec<Flight<P>>,
    window: usize,
}

impl<P> Default for Line<P> {
    fn default() -> Line<P> {
        Line { waiting: VecDeque::new(), flying: Vec::new(), window: WINDOW }
    }
}

/// The answer's payload; `None` if there was none.
pub type Answer<P> = (NodeId, P, Option<Vec<u8>>);

/// All requests to all nodes.
pub struct Calls<P> {
    own: NodeId,
    lines: BTreeMap<NodeId, Line<P>>,
    /// A transfer ID counter for each service of each node, as the protocol wants it.
    counters: HashMap<(NodeId, u16), TransferId>,
    refused: Vec<Answer<P>>,
}

impl<P> Calls<P> {
    pub fn new(own: NodeId) -> Calls<P> {
        Calls { own, lines: BTreeMap::new(), counters: HashMap::new(), refused: Vec::new() }
    }

    /// Puts a request into the node's queue.
    pub fn request(&mut self, node: NodeId, service: DataType, payload: Vec<u8>, patience: Patience, purpose: P) {
        let line = self.lines.entry(node).or_default();
        if line.waiting.len() >= QUEUE_LIMIT {
            return self.refused.push((node, purpose, None));
        }
        line.waiting.push_back(Call { service, payload, patience, attempts_left: patience.attempts, purpose });
    }

    /// A response of a node: whose it is.
    pub fn answered(&mut self, transfer: &Transfer) -> Option<Answer<P>> {
        let CanId::Service { service_id, request: false, destination, source, .. } = transfer.id else {
            return None;
        };
        let line = self.lines.get_mut(&source).filter(|_| destination == self.own)?;
        let of_this = |flight: &Flight<P>| {
            flight.call.service.id == u16::from(service_id) && flight.transfer_id == transfer.transfer_id
        };
        let at = line.flying.iter().position(of_this)?;
        line.window = (line.window + 1).min(WINDOW);
        Some((source, line.flying.swap_remove(at).call.purpose, Some(transfer.payload.clone())))
    }

    /// Sends what may be sent, repeats what was not answered, and gives what failed for good.
    pub fn poll(&mut self, now: Duration, frames: &mut Vec<Frame>) -> Vec<Answer<P>> {
        let mut failed = std::mem::take(&mut self.refused);
        for (node, line) in &mut self.lines {
            let mut overdue = Vec::new();
            while let Some(at) = line.flying.iter().position(|flight| flight.deadline <= now) {
                overdue.push(line.flying.remove(at).call);
            }
            if !overdue.is_empty() {
                line.window = (line.window / 2).max(1);
            }
            // In front and in their order, so that nothing overtakes for ever.
            for call in overdue.into_iter().rev() {
                if call.attempts_left == 0 {
                    failed.push((*node, call.purpose, None));
                } else {
                    line.waiting.push_front(call);
                }
            }
            while line.flying.len() < line.window
                && let Some(mut call) = line.waiting.pop_front()
            {
                let counter = self.counters.entry((*node, call.service.id)).or_default();
                let transfer_id = counter.advance();
                call.attempts_left -= 1;
                let id = CanId::Service {
                    priority: PRIORITY,
                    service_id: call.service.id as u8,
                    request: true,
                    destination: *node,
                    source: self.own,
                };
                let signature = call.service.signature.unwrap_or(0);
                let parts = split(&call.payload, transfer_id, signature);
                frames.extend(parts.iter().map(|data| Frame::extended(id.build(), data)));
                line.flying.push(Flight { transfer_id, deadline: now + call.patience.timeout, call });
            }
        }
        failed
    }

    /// When [`poll`](Calls::poll) has something to do next.
    pub fn deadline(&self) -> Option<Duration> {
        self.lines.values().flat_map(|line| &line.flying).map(|flight| flight.deadline).min()
    }

    /// Takes back requests to a node that have not been answered, with what they were for.
    pub fn take_back(&mut self, node: NodeId, which: impl Fn(&P) -> bool) -> Vec<P> {
        let Some(line) = self.lines.get_mut(&node) else {
            return Vec::new();
        };
        let (taken, kept): (Vec<_>, Vec<_>) = line.waiting.drain(..).partition(|call| which(&call.purpose));
        line.waiting = kept.into();
        let (flying, kept): (Vec<_>, Vec<_>) = line.flying.drain(..).partition(|flight| which(&flight.call.purpose));
        line.flying = kept;
        taken.into_iter().chain(flying.into_iter().map(|flight| flight.call)).map(|call| call.purpose).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dronecan_host::types::GET_SET;

    const OWN: NodeId = NodeId::new(126).unwrap();
    const NODE: NodeId = NodeId::new(42).unwrap();

    fn calls(count: u32) -> Calls<u32> {
        let mut calls = Calls::new(OWN);
        for purpose in 0..count {
            calls.request(NODE, GET_SET, vec![purpose as u8, 0], Patience::new(100, 3), purpose);
        }
        calls
    }

    fn at(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn sent(calls: &mut Calls<u32>, now: u64) -> Vec<Frame> {
        let mut frames = Vec::new();
        calls.poll(at(now), &mut frames);
        frames
    }

    fn answer(frame: &Frame) -> Transfer {
        let id = CanId::Service { priority: 30, service_id: 11, request: false, destination: OWN, source: NODE };
        Transfer { id, transfer_id: TransferId::new(*frame.data().last().unwrap()), payload: vec![7], frames: 1 }
    }

    #[test]
    fn five_are_on_their_way_at_once_and_answers_make_room() {
        let mut calls = calls(12);
        let frames = sent(&mut calls, 0);
        assert_eq!(frames.len(), 5);
        assert!(sent(&mut calls, 50).is_empty());
        assert_eq!(calls.answered(&answer(&frames[3])), Some((NODE, 3, Some(vec![7]))));
        assert_eq!(sent(&mut calls, 60).len(), 1);
    }

    #[test]
    fn an_answer_counts_once_and_one_to_nobody_not_at_all() {
        let mut calls = calls(1);
        let frames = sent(&mut calls, 0);
        let other = CanId::Service {
            priority: 30,
            service_id: 11,
            request: false,
            destination: NodeId::new(1).unwrap(),
            source: NODE,
        };
        assert_eq!(calls.answered(&Transfer { id: other, ..answer(&frames[0]) }), None);
        assert!(calls.answered(&answer(&frames[0])).is_some());
        assert_eq!(calls.answered(&answer(&frames[0])), None);
    }

    #[test]
    fn what_is_not_answered_is_repeated_with_another_transfer_id_and_then_fails() {
        let mut calls = calls(1);
        let first = sent(&mut calls, 0);
        assert_eq!(calls.deadline(), Some(at(100)));
        let second = sent(&mut calls, 100);
        assert_eq!((first[0].id, second.len()), (second[0].id, 1));
        assert_ne!(first[0].data(), second[0].data());
        assert_eq!(calls.answered(&answer(&first[0])), None, "that one was given up");
        assert_eq!(sent(&mut calls, 200).len(), 1);
        assert_eq!(calls.poll(at(300), &mut Vec::new()), [(NODE, 0, None)]);
        assert_eq!(calls.deadline(), None);
    }

    #[test]
    fn a_node_that_loses_requests_gets_fewer_at_once() {
        let mut calls = calls(12);
        assert_eq!(sent(&mut calls, 0).len(), 5);
        assert_eq!(sent(&mut calls, 100).len(), 2);
        assert_eq!(sent(&mut calls, 200).len(), 1);
    }

    #[test]
    fn a_queue_has_an_end() {
        let mut calls = calls(QUEUE_LIMIT as u32 + 3);
        assert_eq!(calls.poll(at(0), &mut Vec::new()).len(), 3);
    }
}
