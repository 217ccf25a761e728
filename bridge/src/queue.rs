//! What waits for a channel: the most important first, and when there is no room the least important is given up.
//!
//! The classes are in the order in which they leave. A node's status is not queued: each node has one place, in which the newest
//! status replaces one that was not sent yet. So a full channel thins the statuses out, evenly, down to one a second each,
//! and there only after everything less important has stopped.

use crate::message::Out;
use dronecan_host::NodeId;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// From the most to the least important.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// What somebody waits for: acknowledgements, the value after a PARAM_SET, the bridge's heartbeat.
    Answer,
    /// A node's status that is due, so that it comes once a second at least. Not queued here.
    Status,
    Info,
    /// Heartbeats of nodes.
    Heartbeat,
    Parameter,
    Text,
    /// CAN frames.
    Frame,
    /// Statuses beyond one a second. Not queued here.
    MoreStatus,
}

/// All classes with the name that a user reads.
pub const CLASSES: [(Class, &str); 8] = [
    (Class::Answer, "answers"),
    (Class::Status, "statuses"),
    (Class::Info, "infos"),
    (Class::Heartbeat, "heartbeats"),
    (Class::Parameter, "parameters"),
    (Class::Text, "texts"),
    (Class::Frame, "CAN frames"),
    (Class::MoreStatus, "statuses thinned out"),
];

impl Class {
    /// Messages that may wait. All parameters of a large node must fit; CAN frames are worth nothing when they are old.
    fn limit(self) -> usize {
        match self {
            Class::Answer => 256,
            Class::Info | Class::Heartbeat => 128,
            Class::Parameter => 8192,
            Class::Text => 32,
            Class::Frame => 512,
            Class::Status | Class::MoreStatus => 0,
        }
    }
}

/// A status is due when waiting for the node's next could make it more than a second.
const DUE_AFTER: Duration = Duration::from_millis(500);

#[derive(Debug)]
struct Slot {
    status: Option<Out>,
    /// `None` before the first.
    sent_at: Option<Duration>,
}

/// One ground station's queue.
#[derive(Debug)]
pub struct Queue {
    waiting: BTreeMap<Class, VecDeque<Out>>,
    statuses: BTreeMap<NodeId, Slot>,
    /// Statuses of one node are at least this far apart.
    status_interval: Duration,
    /// Given up, by class.
    dropped: BTreeMap<Class, u64>,
}

impl Queue {
    /// `status_interval` is zero for no limit, and never above a second.
    pub fn new(status_interval: Duration) -> Queue {
        Queue { waiting: BTreeMap::new(), statuses: BTreeMap::new(), status_interval, dropped: BTreeMap::new() }
    }

    /// Adds a message. It replaces one that says the same, and the oldest of its class if there is no room.
    pub fn push(&mut self, class: Class, out: Out) {
        let waiting = self.waiting.entry(class).or_default();
        if let Some(key) = out.key()
            && let Some(same) = waiting.iter_mut().find(|other| other.key() == Some(key))
        {
            *same = out;
            return;
        }
        if waiting.len() >= class.limit() {
            waiting.pop_front();
            *self.dropped.entry(class).or_default() += 1;
        }
        waiting.push_back(out);
    }

    /// Adds a node's status.
    pub fn push_status(&mut self, node: NodeId, status: Out) {
        let slot = self.statuses.entry(node).or_insert(Slot { status: None, sent_at: None });
        if slot.status.replace(status).is_some() {
            *self.dropped.entry(Class::MoreStatus).or_default() += 1;
        }
    }

    /// Whether the last status of that node still waits.
    pub fn has_status(&self, node: NodeId) -> bool {
        self.statuses.get(&node).is_some_and(|slot| slot.status.is_some())
    }

    /// A node has gone: what it said last is no news.
    pub fn forget(&mut self, node: NodeId) {
        self.statuses.remove(&node);
    }

    /// The next message, if there is one that may leave now.
    pub fn pop(&mut self, now: Duration) -> Option<Out> {
        self.pop_waiting(Class::Answer..Class::Status)
            .or_else(|| self.pop_status(now, self.status_interval.max(DUE_AFTER)))
            .or_else(|| self.pop_waiting(Class::Info..Class::MoreStatus))
            .or_else(|| self.pop_status(now, self.status_interval))
    }

    fn pop_waiting(&mut self, classes: std::ops::Range<Class>) -> Option<Out> {
        self.waiting.range_mut(classes).find_map(|(_, waiting)| waiting.pop_front())
    }

    /// The status whose node has waited longest.
    fn pop_status(&mut self, now: Duration, interval: Duration) -> Option<Out> {
        let may = |slot: &&mut Slot| slot.status.is_some() && slot.sent_at.is_none_or(|sent| now >= sent + interval);
        let slot = self.statuses.values_mut().filter(may).min_by_key(|slot| slot.sent_at)?;
        slot.sent_at = Some(now);
        slot.status.take()
    }

    /// When something that waits may leave; `None` if nothing waits.
    pub fn next(&self) -> Option<Duration> {
        if self.waiting.values().any(|waiting| !waiting.is_empty()) {
            return Some(Duration::ZERO);
        }
        let waiting = self.statuses.values().filter(|slot| slot.status.is_some());
        waiting.map(|slot| slot.sent_at.map_or(Duration::ZERO, |sent| sent + self.status_interval)).min()
    }

    /// What was given up, by class.
    pub fn dropped(&self) -> &BTreeMap<Class, u64> {
        &self.dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{Content, text};

    fn out(component: u8, words: &str) -> Out {
        Out { component, content: Content::from(text(words)) }
    }

    fn node(id: u8) -> NodeId {
        NodeId::new(id).unwrap()
    }

    fn at(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn the_most_important_leaves_first() {
        let mut queue = Queue::new(Duration::ZERO);
        queue.push(Class::Frame, out(1, "frame"));
        queue.push(Class::Text, out(2, "text"));
        queue.push_status(node(42), out(3, "status"));
        queue.push(Class::Parameter, out(4, "parameter"));
        queue.push(Class::Answer, out(5, "answer"));
        let order: Vec<u8> = std::iter::from_fn(|| queue.pop(at(0))).map(|out| out.component).collect();
        assert_eq!(order, [5, 3, 4, 2, 1]);
    }

    #[test]
    fn a_status_beyond_one_a_second_leaves_last() {
        let mut queue = Queue::new(Duration::ZERO);
        queue.push_status(node(42), out(42, "first"));
        queue.pop(at(0)).unwrap();
        queue.push_status(node(42), out(42, "second"));
        queue.push(Class::Frame, out(1, "frame"));
        assert_eq!(queue.pop(at(100)).unwrap().component, 1);
        assert_eq!(queue.pop(at(100)).unwrap().component, 42);
        queue.push_status(node(42), out(42, "third"));
        queue.push(Class::Frame, out(1, "frame"));
        assert_eq!(queue.pop(at(601)).unwrap().component, 42);
    }

    #[test]
    fn a_newer_status_replaces_the_older_and_is_counted() {
        let mut queue = Queue::new(Duration::ZERO);
        (0..10).for_each(|_| queue.push_status(node(42), out(42, "status")));
        assert!(queue.pop(at(0)).is_some() && queue.pop(at(0)).is_none());
        assert_eq!(queue.dropped()[&Class::MoreStatus], 9);
    }

    #[test]
    fn nodes_take_turns() {
        let mut queue = Queue::new(Duration::ZERO);
        let mut counts = [0; 31];
        for ms in 0..10_000 {
            if ms % 100 == 0 {
                (1..=30).for_each(|id| queue.push_status(node(id), out(id, "status")));
            }
            // Room for 40 a second.
            if ms % 25 == 0 {
                counts[usize::from(queue.pop(at(ms)).unwrap().component)] += 1;
            }
        }
        assert!(counts[1..].iter().all(|count| (12..=15).contains(count)), "{counts:?}");
    }

    #[test]
    fn a_limited_rate_delays_and_loses_none_of_one_a_second() {
        let mut queue = Queue::new(at(950));
        let mut sent = 0;
        for ms in 0..60_000 {
            // A node whose clock is half a percent fast, with jitter.
            if ms % 995 == ms / 7 % 5 {
                queue.push_status(node(42), out(42, "status"));
            }
            sent += usize::from(queue.pop(at(ms)).is_some());
        }
        assert!((60..=62).contains(&sent), "{sent}");
    }

    #[test]
    fn a_full_class_gives_up_its_oldest() {
        let mut queue = Queue::new(Duration::ZERO);
        (0..=40).for_each(|n| queue.push(Class::Text, out(n, &format!("text {n}"))));
        assert_eq!(queue.dropped()[&Class::Text], 9);
        assert_eq!(queue.pop(at(0)).unwrap().component, 9);
    }
}
