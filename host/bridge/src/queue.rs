//! The queue of a channel, which chooses the next message.
//!
//! Each class of messages has a share of the channel. A class that needs less leaves the rest to
//! the others, in proportion to their shares, and its messages leave at once. A node's status is
//! not queued: each node has one slot, in which the newest status replaces an unsent one. One
//! status a second of each node counts for the class; further statuses leave only if nothing
//! else waits.
//!
//! Each class has a clock that advances by the bytes sent, divided by the class's share. The class
//! whose clock is behind is next (stride scheduling). A class without messages does not save up
//! time.

use crate::message::Out;
use dronecan_host::NodeId;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Order of classes whose clocks are equal: the first leaves first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// Messages that a station waits for: acknowledgements, the value after a PARAM_SET, the
    /// bridge's heartbeat.
    Answer,
    /// A node's status that is due, so that it is sent once a second at least. Has slots and no
    /// queue.
    Status,
    Info,
    /// Heartbeats of nodes.
    Heartbeat,
    Parameter,
    Text,
    /// CAN frames.
    Frame,
    /// Statuses beyond one a second. Have slots and no queue.
    MoreStatus,
}

/// All classes with the names that the user sees.
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
    /// Maximum number of queued messages. All parameters of a large node must fit; old CAN frames
    /// are useless.
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

    /// Share in percent, while all classes have messages. Statuses have the most, because a node
    /// without them counts as offline. Their share at 9600 baud is enough for one status a
    /// second of 15 nodes.
    fn share(self) -> f64 {
        match self {
            Class::Status => 35.0,
            Class::Answer => 25.0,
            Class::Parameter => 15.0,
            Class::Info | Class::Heartbeat => 10.0,
            Class::Text => 3.0,
            Class::Frame => 2.0,
            Class::MoreStatus => 0.0,
        }
    }
}

/// A status is due a little less than a second after the last, because the clock of a node that
/// sends one a second may be fast.
const DUE_AFTER: Duration = Duration::from_millis(950);

#[derive(Debug, Default)]
struct Slot {
    status: Option<Out>,
    /// `None` before the first status.
    sent_at: Option<Duration>,
}

impl Slot {
    fn may_leave(&self, now: Duration, interval: Duration) -> bool {
        self.status.is_some() && self.sent_at.is_none_or(|sent| now >= sent + interval)
    }
}

/// The queue of one ground station.
#[derive(Debug, Default)]
pub struct Queue {
    waiting: BTreeMap<Class, VecDeque<Out>>,
    statuses: BTreeMap<NodeId, Slot>,
    /// Minimum time between statuses of one node.
    status_interval: Duration,
    /// Bytes that each class has sent, divided by its share.
    clocks: BTreeMap<Class, f64>,
    /// The clock of the class that sent last.
    clock: f64,
    /// Number of dropped messages, by class.
    dropped: BTreeMap<Class, u64>,
}

impl Queue {
    /// `status_interval` is at most a second; zero means no limit.
    pub fn new(status_interval: Duration) -> Queue {
        Queue { status_interval, ..Queue::default() }
    }

    /// Adds a message. It replaces one with the same key, or the oldest of its class if there is no
    /// room.
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
        let slot = self.statuses.entry(node).or_default();
        if slot.status.replace(status).is_some() {
            *self.dropped.entry(Class::MoreStatus).or_default() += 1;
        }
    }

    /// True if the last status of this node was not sent yet.
    pub fn has_status(&self, node: NodeId) -> bool {
        self.statuses.get(&node).is_some_and(|slot| slot.status.is_some())
    }

    /// Drops the status of a node that has become offline.
    pub fn forget(&mut self, node: NodeId) {
        self.statuses.remove(&node);
    }

    /// The next message that may be sent now. The caller reports its length to [`Queue::sent`].
    pub fn pop(&mut self, now: Duration) -> Option<(Class, Out)> {
        let (ready, idle): (Vec<Class>, Vec<Class>) = CLASSES
            .map(|(class, _)| class)
            .into_iter()
            .partition(|class| self.is_ready(*class, now));
        for class in idle {
            self.clocks.insert(class, self.clock);
        }
        let clock = |class: &Class| self.clocks.get(class).copied().unwrap_or(self.clock);
        let next = ready.into_iter().min_by(|a, b| clock(a).total_cmp(&clock(b)));
        let Some(class) = next else {
            return self.pop_status(now, self.status_interval).map(|out| (Class::MoreStatus, out));
        };
        self.clock = clock(&class);
        let out = match class {
            Class::Status => self.pop_status(now, self.due_after()),
            class => self.waiting.get_mut(&class)?.pop_front(),
        };
        out.map(|out| (class, out))
    }

    /// Notes that a message of this class was sent.
    pub fn sent(&mut self, class: Class, bytes: usize) {
        if class != Class::MoreStatus {
            *self.clocks.entry(class).or_insert(self.clock) += bytes as f64 / class.share();
        }
    }

    fn due_after(&self) -> Duration {
        self.status_interval.max(DUE_AFTER)
    }

    fn is_ready(&self, class: Class, now: Duration) -> bool {
        match class {
            Class::Status => {
                self.statuses.values().any(|slot| slot.may_leave(now, self.due_after()))
            }
            // Never of further statuses, which take what the others leave.
            class => self.waiting.get(&class).is_some_and(|waiting| !waiting.is_empty()),
        }
    }

    /// The status that has waited longest.
    fn pop_status(&mut self, now: Duration, interval: Duration) -> Option<Out> {
        let ready = self.statuses.values_mut().filter(|slot| slot.may_leave(now, interval));
        let slot = ready.min_by_key(|slot| slot.sent_at)?;
        slot.sent_at = Some(now);
        slot.status.take()
    }

    /// When the next message may be sent; `None` if nothing waits.
    pub fn next(&self) -> Option<Duration> {
        if self.waiting.values().any(|waiting| !waiting.is_empty()) {
            return Some(Duration::ZERO);
        }
        let waiting = self.statuses.values().filter(|slot| slot.status.is_some());
        waiting
            .map(|slot| slot.sent_at.map_or(Duration::ZERO, |sent| sent + self.status_interval))
            .min()
    }

    /// Number of dropped messages, by class.
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
        let order: Vec<u8> =
            std::iter::from_fn(|| queue.pop(at(0))).map(|(_, out)| out.component).collect();
        assert_eq!(order, [5, 3, 4, 2, 1]);
    }

    #[test]
    fn a_status_beyond_one_a_second_leaves_last() {
        let mut queue = Queue::new(Duration::ZERO);
        queue.push_status(node(42), out(42, "first"));
        queue.pop(at(0)).unwrap();
        queue.push_status(node(42), out(42, "second"));
        queue.push(Class::Frame, out(1, "frame"));
        assert_eq!(queue.pop(at(100)).unwrap().1.component, 1);
        assert_eq!(queue.pop(at(100)).unwrap().1.component, 42);
        queue.push_status(node(42), out(42, "third"));
        queue.push(Class::Frame, out(1, "frame"));
        assert_eq!(queue.pop(at(1051)).unwrap().1.component, 42);
    }

    #[test]
    fn a_newer_status_replaces_the_older_and_is_counted() {
        let mut queue = Queue::new(Duration::ZERO);
        (0..10).for_each(|_| queue.push_status(node(42), out(42, "status")));
        assert!(queue.pop(at(0)).is_some() && queue.pop(at(0)).is_none());
        assert_eq!(queue.dropped()[&Class::MoreStatus], 9);
    }

    #[test]
    fn statuses_of_nodes_leave_in_turn() {
        let mut queue = Queue::new(Duration::ZERO);
        let mut counts = [0; 31];
        for ms in 0..10_000 {
            if ms % 100 == 0 {
                (1..=30).for_each(|id| queue.push_status(node(id), out(id, "status")));
            }
            // A channel for 40 statuses a second.
            if ms % 25 == 0 {
                counts[usize::from(queue.pop(at(ms)).unwrap().1.component)] += 1;
            }
        }
        assert!(counts[1..].iter().all(|count| (12..=15).contains(count)), "{counts:?}");
    }

    #[test]
    fn a_limited_rate_loses_no_status_of_one_a_second() {
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
    fn a_full_class_drops_its_oldest_message() {
        let mut queue = Queue::new(Duration::ZERO);
        (0..=40).for_each(|n| queue.push(Class::Text, out(n, &format!("text {n}"))));
        assert_eq!(queue.dropped()[&Class::Text], 9);
        assert_eq!(queue.pop(at(0)).unwrap().1.component, 9);
    }

    /// Bytes of each class on a channel of 1000 bytes a second in ten seconds, if all classes
    /// always have messages.
    #[test]
    fn busy_classes_share_the_channel_in_proportion() {
        let mut queue = Queue::new(Duration::ZERO);
        let mut sent: BTreeMap<Class, usize> = BTreeMap::new();
        for _ in 0..250 {
            for class in [Class::Answer, Class::Info, Class::Parameter] {
                queue.push(class, out(1, "something"));
            }
            let (class, _) = queue.pop(at(0)).unwrap();
            queue.sent(class, 40);
            *sent.entry(class).or_default() += 40;
        }
        assert!((4900..=5100).contains(&sent[&Class::Answer]), "25 of 50: {sent:?}");
        assert!((1900..=2100).contains(&sent[&Class::Info]), "10 of 50: {sent:?}");
    }

    #[test]
    fn rare_messages_do_not_wait_behind_frequent_ones() {
        let mut queue = Queue::new(Duration::ZERO);
        for n in 0..500 {
            queue.push(Class::Parameter, out(1, "parameter"));
            if n % 20 == 0 {
                queue.push(Class::Answer, out(2, "answer"));
            }
            let (class, _) = queue.pop(at(0)).unwrap();
            queue.sent(class, 40);
            assert_eq!(class == Class::Answer, n % 20 == 0);
        }
    }
}
