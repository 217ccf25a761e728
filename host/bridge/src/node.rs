//! The state of a node on the bus.

use crate::number::Number;
use crate::{names, task::Op};
use dronecan_host::{NodeInfo, NodeStatus, ParameterResponse, TransferId};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Transfer IDs have 5 bits.
const TRANSFER_IDS: u8 = 32;
/// Uptime in which a restart can leave no trace in the uptime.
const FIRST_S: u32 = 1;
/// CAN repeats a frame at once. A restart takes longer.
const REPEATED_WITHIN: Duration = Duration::from_millis(20);

/// A node that has sent a NodeStatus.
#[derive(Debug)]
pub struct Node {
    pub status: NodeStatus,
    /// Time and transfer ID of its last status.
    pub heard: Duration,
    pub transfer_id: TransferId,
    pub is_online: bool,
    /// The uptime before it last decreased. If later statuses fit both uptimes, two nodes have the
    /// ID.
    pub other_uptime: Option<Uptime>,
    /// When a conflict of its ID was last reported.
    pub conflict_logged_at: Option<Duration>,
    /// Number of statuses since it appeared.
    pub statuses: u64,
    pub info: Information,
    /// Its parameters, if they were fetched.
    pub table: Option<Table>,
    /// The fetching of its parameters, if it is in progress.
    pub listing: Option<Listing>,
    /// Operations that wait for the table.
    pub waiting: VecDeque<Op>,
    /// When its changed parameters are to be saved, if they are.
    pub save_at: Option<Duration>,
}

impl Node {
    /// A node that has sent its first status.
    pub fn new(status: NodeStatus, transfer_id: TransferId, now: Duration) -> Node {
        Node {
            status,
            heard: now,
            transfer_id,
            is_online: true,
            other_uptime: None,
            conflict_logged_at: None,
            statuses: 0,
            info: Information::default(),
            table: None,
            listing: None,
            waiting: VecDeque::new(),
            save_at: None,
        }
    }

    /// The uptime in the last status.
    pub fn uptime(&self) -> Uptime {
        Uptime { seconds: self.status.uptime_s, at: self.heard }
    }

    /// True if a status shows that the node began anew within the first seconds of its uptime,
    /// which has not gone back then: the transfer ID has. The same one at once is a frame that the
    /// bus repeated.
    pub fn began_anew(&self, now: Duration, status: &NodeStatus, transfer_id: TransferId) -> bool {
        let ahead = transfer_id.get().wrapping_sub(self.transfer_id.get()) % TRANSFER_IDS;
        let is_repeated = ahead == 0 && now < self.heard + REPEATED_WITHIN;
        let is_behind = ahead == 0 || ahead >= TRANSFER_IDS / 2;
        status.uptime_s <= FIRST_S && self.is_online && is_behind && !is_repeated
    }

    /// Its name, if it has answered GetNodeInfo.
    pub fn name(&self) -> Option<String> {
        self.info.known.as_ref().map(NodeInfo::name)
    }
}

/// An uptime and when it was received.
#[derive(Clone, Copy, Debug)]
pub struct Uptime {
    seconds: u32,
    at: Duration,
}

impl Uptime {
    /// The status has whole seconds and arrives with jitter.
    const TOLERANCE_S: u64 = 1;

    /// True if `status` can come from the same node without a restart in between.
    pub fn fits(&self, now: Duration, status: &NodeStatus) -> bool {
        let expected = u64::from(self.seconds) + now.saturating_sub(self.at).as_secs();
        u64::from(status.uptime_s).abs_diff(expected) <= Self::TOLERANCE_S
    }
}

/// The answer to GetNodeInfo, and the state of the request.
#[derive(Debug, Default)]
pub struct Information {
    pub known: Option<NodeInfo>,
    /// True while a request is unanswered.
    pub is_requested: bool,
    /// Consecutive requests without an answer.
    pub failures: u32,
    pub next_try: Duration,
    /// When the information was last sent to all ground stations.
    pub sent_at: Duration,
    /// Commands that wait for the information.
    pub waiting: Vec<u32>,
}

/// The fetching of parameters by index.
#[derive(Debug, Default)]
pub struct Listing {
    /// The next index to request.
    pub next: u16,
    pub on_their_way: usize,
    pub got: BTreeMap<u16, ParameterResponse>,
    /// The lowest index without a parameter.
    pub end: Option<u16>,
}

/// A parameter that MAVLink can represent.
#[derive(Clone, Debug)]
pub struct Entry {
    pub full: Vec<u8>,
    pub short: String,
    /// The node's last answer about it.
    pub last: ParameterResponse,
}

/// The parameters of a node in its order, and those that MAVLink cannot represent.
#[derive(Debug, Default)]
pub struct Table {
    pub entries: Vec<Entry>,
    pub left_out: Vec<Entry>,
}

impl Table {
    /// Makes the table from all answers of a node.
    pub fn new(parameters: impl IntoIterator<Item = ParameterResponse>) -> Table {
        let all: Vec<ParameterResponse> = parameters.into_iter().collect();
        let names: Vec<Vec<u8>> = all.iter().map(|parameter| parameter.name.clone()).collect();
        let short = names::shorten(&names);
        let entries = all.into_iter().zip(short).map(|(last, short)| Entry {
            full: last.name.clone(),
            short,
            last,
        });
        let (entries, left_out) = entries.partition(|entry| Number::of(&entry.last).is_some());
        Table { entries, left_out }
    }

    /// True if MAVLink cannot represent the parameter with this short name.
    pub fn is_left_out(&self, name: &str) -> bool {
        self.left_out.iter().any(|entry| entry.short.eq_ignore_ascii_case(name))
    }

    /// Index of the parameter with this short name. Case matters only if two names differ in
    /// nothing else.
    pub fn find(&self, name: &str) -> Option<usize> {
        let exact = self.entries.iter().position(|entry| entry.short == name);
        exact.or_else(|| {
            self.entries.iter().position(|entry| entry.short.eq_ignore_ascii_case(name))
        })
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
    fn a_table_leaves_out_parameters_that_mavlink_cannot_represent() {
        let table = Table::new([
            parameter("first", Value::Integer(1)),
            parameter("word", Value::Text(b"x".to_vec())),
            parameter("last", Value::Real(2.0)),
        ]);
        let names: Vec<&str> = table.entries.iter().map(|entry| entry.short.as_str()).collect();
        assert_eq!((names, table.left_out.len()), (vec!["first", "last"], 1));
    }

    #[test]
    fn names_are_found_in_any_case_unless_they_differ_only_in_case() {
        let table = Table::new([
            parameter("limit", Value::Integer(1)),
            parameter("Rate", Value::Integer(2)),
        ]);
        assert_eq!(
            (table.find("LIMIT"), table.find("rate"), table.find("none")),
            (Some(0), Some(1), None)
        );
    }
}
