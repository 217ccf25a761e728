//! Requests to nodes. Several are sent at a time; one without an answer is repeated, and fails
//! after a bounded time.
//!
//! Goals: use a slow bus without flooding it; wait for slow nodes; no node delays requests to other
//! nodes.
//!
//! * Each node has a queue, and a window: the number of requests that may be sent to it and
//!   unanswered at once. A timeout halves the window, because a small node may have room for no
//!   more. Answers widen it again.
//! * All nodes together have a window, too, which adapts in the same way: on a slow bus answers are
//!   late because of the other requests. A node that has never answered does not narrow this
//!   window, because its silence shows nothing about the bus.
//! * The timeout follows from the delay of the answers so far, as in TCP ([`delay`]).
//!
//! Invariants: each attempt has its own transfer ID. An answer to any attempt answers the request.
//! A transfer ID is not used again while an answer with it may still arrive.

mod delay;
#[cfg(test)]
mod tests;

use crate::task::Purpose;
use delay::Delay;
use dronecan_host::{CanId, DataType, Frame, Message, NodeId, Transfer, TransferId};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Largest window of one node. The DroneCAN GUI Tool has the same.
const WINDOW: usize = 5;
/// Largest window of all nodes together. A GetSet and its answer take seven frames, so on a bus of
/// 900 frames a second an answer waits for a quarter of a second behind 32 others.
const TOTAL_WINDOW_MAX: f64 = 32.0;
const TOTAL_WINDOW_MIN: f64 = 2.0;
const TOTAL_WINDOW_AT_FIRST: f64 = 8.0;
/// The second lowest priority: parameters are less urgent than all other traffic.
const PRIORITY: u8 = 30;
/// Maximum length of a node's queue. Further requests fail at once.
const QUEUE_LIMIT: usize = 512;
/// After this time no answer to a request is expected.
const ANSWER_EXPECTED_WITHIN: Duration = Duration::from_secs(4);

/// The timeouts of a request.
#[derive(Clone, Copy, Debug)]
pub struct Timeouts {
    /// Time from the first attempt to the second, while the node's delay is not known.
    pub repeat_after: Duration,
    /// Time from the first attempt to the failure of the request.
    pub give_up_after: Duration,
}

impl Timeouts {
    /// Both times in milliseconds.
    pub const fn from_ms(repeat_after: u64, give_up_after: u64) -> Timeouts {
        Timeouts {
            repeat_after: Duration::from_millis(repeat_after),
            give_up_after: Duration::from_millis(give_up_after),
        }
    }
}

/// The order of requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Urgency {
    /// A station waits for this answer. The request ignores the window of all nodes.
    Now,
    /// One request of a list.
    Background,
}

#[derive(Clone, Copy, Debug)]
struct Attempt {
    transfer_id: TransferId,
    sent: Duration,
}

/// A request and its purpose.
#[derive(Clone, Debug)]
struct Call<P> {
    service: DataType,
    payload: Vec<u8>,
    timeouts: Timeouts,
    urgency: Urgency,
    purpose: P,
    attempts: Vec<Attempt>,
    /// When the last attempt times out.
    deadline: Duration,
}

impl<P> Call<P> {
    /// When the request fails. `None` before the first attempt.
    fn fails_at(&self) -> Option<Duration> {
        self.attempts.first().map(|first| first.sent + self.timeouts.give_up_after)
    }

    fn has_failed(&self, now: Duration) -> bool {
        self.fails_at().is_some_and(|at| now >= at)
    }
}

/// The queue and the window of one node.
struct Line<P> {
    waiting: VecDeque<Call<P>>,
    flying: Vec<Call<P>>,
    window: usize,
    delay: Delay,
    /// Transfer ID counters by service, as the protocol requires.
    counters: BTreeMap<u16, TransferId>,
    /// Attempts of completed requests whose answers may still arrive.
    orphans: Vec<(u16, Attempt)>,
}

impl<P> Default for Line<P> {
    fn default() -> Line<P> {
        Line {
            waiting: VecDeque::new(),
            flying: Vec::new(),
            window: WINDOW,
            delay: Delay::default(),
            counters: BTreeMap::new(),
            orphans: Vec::new(),
        }
    }
}

impl<P> Line<P> {
    /// Adds a request behind those of the same urgency.
    fn push(&mut self, call: Call<P>) {
        let at = self
            .waiting
            .iter()
            .position(|other| other.urgency > call.urgency)
            .unwrap_or(self.waiting.len());
        self.waiting.insert(at, call);
    }

    /// Removes and returns the request that the answer is for.
    fn take_answered(&mut self, service: u16, transfer_id: TransferId) -> Option<Call<P>> {
        let is_it = |call: &Call<P>| {
            call.service.id == service
                && call.attempts.iter().any(|this| this.transfer_id == transfer_id)
        };
        if let Some(at) = self.flying.iter().position(is_it) {
            return Some(self.flying.swap_remove(at));
        }
        let at = self.waiting.iter().position(is_it)?;
        self.waiting.remove(at)
    }

    /// Ends a request. Later answers to its other attempts are ignored.
    fn abandon(&mut self, call: &Call<P>, answered: Option<TransferId>) {
        let others = call.attempts.iter().filter(|this| Some(this.transfer_id) != answered);
        self.orphans.extend(others.map(|this| (call.service.id, *this)));
    }

    /// The next transfer ID that no outstanding attempt has.
    fn transfer_id(&mut self, service: u16) -> TransferId {
        let calls =
            self.flying.iter().chain(&self.waiting).filter(|call| call.service.id == service);
        let expected = calls.flat_map(|call| &call.attempts);
        let orphaned = self.orphans.iter().filter(|(of, _)| *of == service).map(|(_, this)| this);
        let used: Vec<TransferId> = expected.chain(orphaned).map(|this| this.transfer_id).collect();
        let counter = self.counters.entry(service).or_default();
        let first = counter.advance();
        let mut id = first;
        while used.contains(&id) {
            id = counter.advance();
            if id == first {
                break;
            }
        }
        id
    }
}

/// The node, the purpose, and the payload of the answer; `None` if the request failed.
pub type Answer<P> = (NodeId, P, Option<Vec<u8>>);

impl Calls<Purpose> {
    /// Puts a request into the node's queue, with the timeouts and the urgency of its purpose.
    pub fn ask(&mut self, node: NodeId, message: &Message, purpose: Purpose) {
        if let Some((service, payload)) = message.encode() {
            let (timeouts, urgency) = purpose.pace();
            self.request(node, *service, payload, timeouts, urgency, purpose);
        }
    }
}

/// All requests to all nodes.
pub struct Calls<P> {
    own: NodeId,
    lines: BTreeMap<NodeId, Line<P>>,
    refused: Vec<Answer<P>>,
    /// Window of all nodes together.
    window: f64,
    /// When that window was last narrowed. Requests that were lost together narrow it once.
    narrowed_at: Option<Duration>,
    /// The node that was served last. The next round starts after it.
    served: Option<NodeId>,
    /// Delay of all nodes' answers, for a node that has not answered yet.
    delay: Delay,
}

impl<P> Calls<P> {
    pub fn new(own: NodeId) -> Calls<P> {
        Calls {
            own,
            lines: BTreeMap::new(),
            refused: Vec::new(),
            window: TOTAL_WINDOW_AT_FIRST,
            narrowed_at: None,
            served: None,
            delay: Delay::default(),
        }
    }

    /// Puts a request into the node's queue.
    fn request(
        &mut self,
        node: NodeId,
        service: DataType,
        payload: Vec<u8>,
        timeouts: Timeouts,
        urgency: Urgency,
        purpose: P,
    ) {
        let line = self.lines.entry(node).or_default();
        if line.waiting.len() >= QUEUE_LIMIT {
            return self.refused.push((node, purpose, None));
        }
        let (attempts, deadline) = (Vec::new(), Duration::ZERO);
        line.push(Call { service, payload, timeouts, urgency, purpose, attempts, deadline });
    }

    /// Finds the request that a response answers.
    pub fn answered(&mut self, now: Duration, transfer: &Transfer) -> Option<Answer<P>> {
        let CanId::Service { service_id, request: false, destination, source, .. } = transfer.id
        else {
            return None;
        };
        let line = self.lines.get_mut(&source).filter(|_| destination == self.own)?;
        let (service, transfer_id) = (u16::from(service_id), transfer.transfer_id);
        let Some(call) = line.take_answered(service, transfer_id) else {
            line.orphans.retain(|(of, this)| (*of, this.transfer_id) != (service, transfer_id));
            return None;
        };
        if let Some(this) = call.attempts.iter().find(|this| this.transfer_id == transfer_id) {
            let delay = now.saturating_sub(this.sent);
            line.delay.measured(delay);
            self.delay.measured(delay);
        }
        line.abandon(&call, Some(transfer_id));
        line.window = (line.window + 1).min(WINDOW);
        self.window = (self.window + 1.0 / self.window).min(TOTAL_WINDOW_MAX);
        Some((source, call.purpose, Some(transfer.payload.clone())))
    }

    /// Sends and repeats requests. Returns those that have failed.
    pub fn poll(&mut self, now: Duration, frames: &mut Vec<Frame>) -> Vec<Answer<P>> {
        let mut failed = std::mem::take(&mut self.refused);
        self.requeue_overdue(now, &mut failed);
        let mut flying: usize = self.lines.values().map(|line| line.flying.len()).sum();
        // Each round sends one request per node and starts after the node that was served last.
        let served = self.served;
        let mut order: Vec<NodeId> = self.lines.keys().copied().collect();
        let behind = order.iter().position(|node| Some(*node) > served).unwrap_or(0);
        order.rotate_left(behind);
        let mut sent = true;
        while std::mem::take(&mut sent) {
            for node in &order {
                if self.send_one(*node, now, flying, frames) {
                    self.served = Some(*node);
                    flying += 1;
                    sent = true;
                }
            }
        }
        failed
    }

    /// Puts requests that timed out back at the front of their queues, in order.
    fn requeue_overdue(&mut self, now: Duration, failed: &mut Vec<Answer<P>>) {
        for (node, line) in &mut self.lines {
            line.orphans.retain(|(_, this)| now < this.sent + ANSWER_EXPECTED_WITHIN);
            let is_overdue = |call: &mut Call<P>| call.deadline <= now;
            let overdue: Vec<Call<P>> = line.flying.extract_if(.., is_overdue).collect();
            if !overdue.is_empty() {
                line.window = (line.window / 2).max(1);
                let last_sent = overdue
                    .iter()
                    .flat_map(|call| call.attempts.last())
                    .map(|this| this.sent)
                    .max();
                if line.delay.is_known() && self.narrowed_at < last_sent {
                    self.window = (self.window / 2.0).max(TOTAL_WINDOW_MIN);
                    self.narrowed_at = Some(now);
                }
                line.delay.timed_out();
            }
            for call in overdue.into_iter().rev() {
                line.waiting.push_front(call);
            }
            while let Some(at) = line.waiting.iter().position(|call| call.has_failed(now)) {
                let Some(call) = line.waiting.remove(at) else { break };
                line.abandon(&call, None);
                failed.push((*node, call.purpose, None));
            }
        }
    }

    /// Sends the next request to a node. Returns `false` if there is none, or if the windows are
    /// full.
    fn send_one(
        &mut self,
        node: NodeId,
        now: Duration,
        flying: usize,
        frames: &mut Vec<Frame>,
    ) -> bool {
        let Some(line) = self.lines.get_mut(&node) else { return false };
        let Some(next) = line.waiting.front() else { return false };
        let has_room = next.urgency == Urgency::Now || flying < self.window as usize;
        if line.flying.len() >= line.window || !has_room {
            return false;
        }
        let Some(mut call) = line.waiting.pop_front() else { return false };
        let transfer_id = line.transfer_id(call.service.id);
        call.attempts.push(Attempt { transfer_id, sent: now });
        call.deadline = now + line.delay.timeout(call.timeouts.repeat_after, &self.delay);
        if let Some(at) = call.fails_at() {
            call.deadline = call.deadline.min(at);
        }
        let id = CanId::Service {
            priority: PRIORITY,
            service_id: call.service.id as u8,
            request: true,
            destination: node,
            source: self.own,
        };
        frames.extend(dronecan_host::frames(id, &call.payload, transfer_id));
        line.flying.push(call);
        true
    }

    /// When [`poll`](Calls::poll) must be called next.
    pub fn deadline(&self) -> Option<Duration> {
        let flying = self.lines.values().flat_map(|line| &line.flying).map(|call| call.deadline);
        let waiting = self.lines.values().flat_map(|line| &line.waiting).filter_map(Call::fails_at);
        flying.chain(waiting).min()
    }

    /// Removes the unanswered requests to a node that satisfy `which`, and returns their purposes.
    pub fn remove_requests(&mut self, node: NodeId, which: impl Fn(&P) -> bool) -> Vec<P> {
        let Some(line) = self.lines.get_mut(&node) else {
            return Vec::new();
        };
        let waiting = std::mem::take(&mut line.waiting);
        let (mut taken, kept): (VecDeque<_>, VecDeque<_>) =
            waiting.into_iter().partition(|call| which(&call.purpose));
        line.waiting = kept;
        taken.extend(line.flying.extract_if(.., |call| which(&call.purpose)));
        taken.iter().for_each(|call| line.abandon(call, None));
        taken.into_iter().map(|call| call.purpose).collect()
    }
}
