//! A centralized allocator of node IDs (specification, chapter 6, "Dynamic node ID allocation").
//!
//! A node sends its unique ID in three anonymous messages. After each, the allocator broadcasts the
//! bytes that it has so far. With the last broadcast it grants an ID. It serves one node at a time:
//! a new request replaces the one in progress. Until the end of the run the same unique ID gets the
//! same node ID.

use crate::dronecan::{Allocation, NodeId};
use crate::{Cycles, F_CPU_HZ};

/// Time in which the node must send its next message, or begin again (DSDL 1.Allocation.uavcan,
/// FOLLOWUP_TIMEOUT_MS).
const FOLLOWUP_TIMEOUT: Cycles = F_CPU_HZ / 2;
/// For each of the three requests: the number of bytes of the unique ID before it, and in it.
const STAGES: [(usize, usize); 3] = [(0, 6), (6, 6), (12, 4)];
const UNIQUE_ID_LEN: usize = 16;
/// Highest ID to grant: 126 and 127 are for tools.
const HIGHEST: u8 = 125;

/// A centralized allocator of node IDs.
#[derive(Clone, Debug)]
pub struct Allocator {
    /// Unique IDs and the node IDs granted to them.
    granted: Vec<([u8; UNIQUE_ID_LEN], NodeId)>,
    /// IDs that other nodes use already.
    taken: Vec<NodeId>,
    so_far: Vec<u8>,
    last_request_at: Cycles,
}

impl Allocator {
    /// An allocator that has granted nothing. It never grants `own`, its own ID.
    pub fn new(own: NodeId) -> Allocator {
        Allocator { granted: Vec::new(), taken: vec![own], so_far: Vec::new(), last_request_at: 0 }
    }

    /// Notes that a node with this ID is on the bus.
    pub fn add_taken(&mut self, id: NodeId) {
        if !self.taken.contains(&id) {
            self.taken.push(id);
        }
    }

    /// Unique IDs and the node IDs granted to them.
    pub fn granted(&self) -> &[([u8; UNIQUE_ID_LEN], NodeId)] {
        &self.granted
    }

    /// Processes an anonymous request at time `at`. Returns the answer to broadcast; `None` if the
    /// request does not fit.
    pub fn answer(&mut self, request: &Allocation, at: Cycles) -> Option<Allocation> {
        if at.saturating_sub(self.last_request_at) > FOLLOWUP_TIMEOUT || request.first_part {
            self.so_far.clear();
        }
        let fits = STAGES.contains(&(self.so_far.len(), request.unique_id.len()));
        if !fits || request.first_part != self.so_far.is_empty() {
            return None;
        }
        self.last_request_at = at;
        self.so_far.extend(&request.unique_id);
        let mut answer = Allocation { unique_id: self.so_far.clone(), ..Allocation::default() };
        if let Ok(unique_id) = self.so_far.as_slice().try_into() {
            answer.node_id = self.grant(unique_id, request.node_id)?.get();
            self.so_far.clear();
        }
        Some(answer)
    }

    /// The ID for a unique ID: the one granted before, or the free one nearest to `preferred`,
    /// first upwards and then downwards. `None` if no ID is free.
    fn grant(&mut self, unique_id: [u8; UNIQUE_ID_LEN], preferred: u8) -> Option<NodeId> {
        if let Some((_, id)) = self.granted.iter().find(|(known, _)| *known == unique_id) {
            return Some(*id);
        }
        let from = if preferred == 0 { HIGHEST } else { preferred.min(HIGHEST) };
        let is_free = |id: &NodeId| {
            !self.taken.contains(id) && !self.granted.iter().any(|(_, other)| other == id)
        };
        let id = (from..=HIGHEST).chain((1..from).rev()).filter_map(NodeId::new).find(is_free)?;
        self.granted.push((unique_id, id));
        Some(id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Cycles = F_CPU_HZ / 1000;

    fn allocator() -> Allocator {
        Allocator::new(NodeId::new(1).unwrap())
    }

    fn unique_id(first: u8) -> Vec<u8> {
        (first..first + 16).collect()
    }

    /// The three requests of a node with this unique ID.
    fn requests(unique_id: &[u8], preferred: u8) -> [Allocation; 3] {
        STAGES.map(|(at, len)| Allocation {
            node_id: preferred,
            first_part: at == 0,
            unique_id: unique_id[at..at + len].to_vec(),
        })
    }

    #[track_caller]
    fn allocate(allocator: &mut Allocator, unique_id: &[u8], preferred: u8) -> u8 {
        let mut answers =
            requests(unique_id, preferred).map(|request| allocator.answer(&request, MS).unwrap());
        for (answer, known) in answers.iter().zip([6, 12, 16]) {
            assert_eq!(answer.unique_id, unique_id[..known]);
            assert!(!answer.first_part && (answer.node_id == 0) == (known < 16));
        }
        std::mem::take(&mut answers[2].node_id)
    }

    #[test]
    fn ids_are_granted_from_125_down_and_kept() {
        let mut allocator = allocator();
        assert_eq!(allocate(&mut allocator, &unique_id(0), 0), 125);
        assert_eq!(allocate(&mut allocator, &unique_id(1), 0), 124);
        assert_eq!(allocate(&mut allocator, &unique_id(0), 0), 125);
        assert_eq!(allocator.granted().len(), 2);
    }

    #[test]
    fn a_preferred_id_is_granted_if_it_is_free() {
        let mut allocator = allocator();
        allocator.add_taken(NodeId::new(42).unwrap());
        assert_eq!(allocate(&mut allocator, &unique_id(0), 55), 55);
        assert_eq!(allocate(&mut allocator, &unique_id(1), 42), 43);
        assert_eq!(allocate(&mut allocator, &unique_id(2), 125), 125);
        assert_eq!(allocate(&mut allocator, &unique_id(3), 127), 124);
    }

    #[test]
    fn a_follow_up_that_does_not_fit_or_comes_late_is_not_answered() {
        let mut allocator = allocator();
        let [first, second, third] = requests(&unique_id(0), 0);
        assert_eq!(allocator.answer(&second, 0), None);
        assert!(allocator.answer(&first, 0).is_some());
        assert_eq!(allocator.answer(&third, 0), None);
        assert_eq!(allocator.answer(&second, FOLLOWUP_TIMEOUT + 1), None);
        assert!(allocator.answer(&first, 600 * MS).is_some());
        assert!(allocator.answer(&second, 600 * MS + FOLLOWUP_TIMEOUT).is_some());
    }

    #[test]
    fn a_new_request_replaces_one_in_progress() {
        let mut allocator = allocator();
        let [first, second, _] = requests(&unique_id(0), 0);
        assert!(allocator.answer(&first, 0).is_some() && allocator.answer(&second, 0).is_some());
        assert_eq!(allocate(&mut allocator, &unique_id(7), 0), 125);
    }

    #[test]
    fn when_all_ids_are_taken_none_is_granted() {
        let mut allocator = allocator();
        (1..=125).filter_map(NodeId::new).for_each(|id| allocator.add_taken(id));
        let answers = requests(&unique_id(0), 0).map(|request| allocator.answer(&request, MS));
        assert!(answers[1].is_some() && answers[2].is_none());
    }
}
