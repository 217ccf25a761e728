//! What is known of a node on the bus.

use crate::number::Number;
use crate::{names, task::Op};
use dronecan_host::{NodeInfo, NodeStatus, ParameterResponse};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// A node that has been heard.
#[derive(Debug)]
pub struct Node {
    pub status: NodeStatus,
    /// When its last status came.
    pub heard: Duration,
    pub online: bool,
    /// The uptime before it last went back. If statuses follow both, there are two nodes.
    pub other_uptime: Option<Uptime>,
    /// When a conflict of its ID was last reported.
    pub conflict_said: Option<Duration>,
    /// Statuses since it appeared.
    pub statuses: u64,
    pub info: Information,
    /// Its parameters, once they have been asked for.
    pub table: Option<Table>,
    /// They are being asked for.
    pub listing: Option<Listing>,
    /// What waits for the table.
    pub waiting: VecDeque<Op>,
    /// It has been changed, and is to be saved then.
    pub save_at: Option<Duration>,
}

impl Node {
    /// One that was heard for the first time.
    pub fn new(status: NodeStatus, now: Duration) -> Node {
        Node {
            status,
            heard: now,
            online: true,
            other_uptime: None,
            conflict_said: None,
            statuses: 0,
            info: Information::default(),
            table: None,
            listing: None,
            waiting: VecDeque::new(),
            save_at: None,
        }
    }

    /// As it was in the last status.
    pub fn uptime(&self) -> Uptime {
        Uptime { seconds: self.status.uptime_s, at: self.heard }
    }

    /// Its name, once it has answered.
    pub fn name(&self) -> Option<String> {
        self.info.known.as_ref().map(NodeInfo::name)
    }
}

/// An uptime that was heard at some time.
#[derive(Clone, Copy, Debug)]
pub struct Uptime {
    seconds: u32,
    at: Duration,
}

impl Uptime {
    /// The status has whole seconds, and arrives at a time that is not exact.
    const TOLERANCE_S: u64 = 1;

    /// True if `status` may be of the same node, which has not restarted since.
    pub fn fits(&self, now: Duration, status: &NodeStatus) -> bool {
        let expected = u64::from(self.seconds) + now.saturating_sub(self.at).as_secs();
        u64::from(status.uptime_s).abs_diff(expected) <= Self::TOLERANCE_S
    }
}

/// The answer to GetNodeInfo, and the state of the request.
#[derive(Debug, Default)]
pub struct Information {
    pub known: Option<NodeInfo>,
    /// It has been asked and has not answered yet.
    pub asked: bool,
    /// Failures in a row.
    pub failures: u32,
    pub next_try: Duration,
    /// When it was last sent to all ground stations.
    pub sent_at: Duration,
    /// Commands that wait for it.
    pub waiting: Vec<u32>,
}

/// Parameters that are being fetched by index.
#[derive(Debug, Default)]
pub struct Listing {
    /// The next index to ask for.
    pub next: u16,
    pub on_their_way: usize,
    pub got: BTreeMap<u16, ParameterResponse>,
    /// The lowest index that there is no parameter at.
    pub end: Option<u16>,
}

/// A parameter as MAVLink shows it.
#[derive(Clone, Debug)]
pub struct Entry {
    pub full: Vec<u8>,
    pub short: String,
    /// From the last answer of the node.
    pub last: ParameterResponse,
}

/// The parameters of a node, in its order, and what MAVLink cannot carry.
#[derive(Debug, Default)]
pub struct Table {
    pub entries: Vec<Entry>,
    pub left_out: Vec<Entry>,
}

impl Table {
    /// From all answers of a node.
    pub fn new(parameters: impl IntoIterator<Item = ParameterResponse>) -> Table {
        let all: Vec<ParameterResponse> = parameters.into_iter().collect();
        let names: Vec<Vec<u8>> = all.iter().map(|parameter| parameter.name.clone()).collect();
        let short = names::shorten(&names);
        let entries = all.into_iter().zip(short).map(|(last, short)| Entry { full: last.name.clone(), short, last });
        let (entries, left_out) = entries.partition(|entry| Number::of(&entry.last).is_some());
        Table { entries, left_out }
    }

    /// True if the parameter with that short name is one that MAVLink cannot carry.
    pub fn leaves_out(&self, name: &str) -> bool {
        self.left_out.iter().any(|entry| entry.short.eq_ignore_ascii_case(name))
    }

    /// Where the parameter with that short name is. Upper and lower case count only where they must.
    pub fn find(&self, name: &str) -> Option<usize> {
        let exact = self.entries.iter().position(|entry| entry.short == name);
        exact.or_else(|| self.entries.iter().position(|entry| entry.short.eq_ignore_ascii_case(name)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dronecan_host::Value;

    fn parameter(name: &str, value: Value) -> ParameterResponse {
        ParameterResponse { name: name.into(), value, ..ParameterResponse::default() }
    }

    #[test]
    fn a_table_leaves_out_what_mavlink_cannot_carry() {
        let table = Table::new([
            parameter("first", Value::Integer(1)),
            parameter("word", Value::Text(b"x".to_vec())),
            parameter("last", Value::Real(2.0)),
        ]);
        let names: Vec<&str> = table.entries.iter().map(|entry| entry.short.as_str()).collect();
        assert_eq!((names, table.left_out.len()), (vec!["first", "last"], 1));
    }

    #[test]
    fn names_are_found_in_any_case_unless_the_case_tells_them_apart() {
        let table = Table::new([parameter("limit", Value::Integer(1)), parameter("Rate", Value::Integer(2))]);
        assert_eq!((table.find("LIMIT"), table.find("rate"), table.find("none")), (Some(0), Some(1), None));
    }
}
