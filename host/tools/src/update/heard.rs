//! The other nodes that were heard on the bus, and when.

use std::collections::BTreeMap;
use std::time::Duration;

use dronecan_host::NodeId;

/// A node that was not heard for this long is not on the bus: each one sends NodeStatus once a
/// second.
const GONE_AFTER: Duration = Duration::from_secs(2);

/// The other nodes that have sent a frame, with the time of the last one.
#[derive(Clone, Debug, Default)]
pub struct Heard(BTreeMap<NodeId, Duration>);

impl Heard {
    /// Notes a frame.
    pub fn note(&mut self, id: NodeId, now: Duration) {
        self.0.insert(id, now);
    }

    /// True if the node has sent a frame since the start of the program.
    pub fn contains(&self, id: NodeId) -> bool {
        self.0.contains_key(&id)
    }

    /// True if the node has sent a frame in the last two seconds.
    pub fn is_on_bus(&self, id: NodeId, now: Duration) -> bool {
        self.0.get(&id).is_some_and(|at| now < *at + GONE_AFTER)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_that_was_silent_for_two_seconds_is_gone() {
        let (id, second) = (NodeId::new(126).unwrap(), Duration::from_secs(1));
        let mut heard = Heard::default();
        heard.note(id, second);
        assert!(heard.is_on_bus(id, 2 * second) && !heard.is_on_bus(id, 3 * second));
        assert!(heard.contains(id) && !heard.contains(NodeId::new(1).unwrap()));
    }
}
