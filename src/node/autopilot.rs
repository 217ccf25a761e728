//! Finds the autopilot among the nodes on the bus.
//!
//! ArduPilot is node 10 by default, PX4 and the thesis's autopilot are node 1, and on a bench a GUI tool may command the servo. So the autopilot is
//! the node that sent the last valid command: one that was followed, or rejected only because the vehicle was disarmed. Before the first command it
//! is the lowest node ID that sends a NodeStatus, because flight controllers have low IDs and tools have high ones. An autopilot that is silent for
//! three seconds is offline, as in the specification.

use dronecan_wire::NodeId;

/// Timeout after which a silent node is offline, in milliseconds (DSDL 341.NodeStatus.uavcan, OFFLINE_TIMEOUT_MS).
const OFFLINE_TIMEOUT_MS: u16 = 3000;

/// The autopilot, if there is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Autopilot {
    id: Option<NodeId>,
    /// The node that sent the last valid command, or 0. It is the autopilot even if its ID is not the lowest.
    commander: u8,
    heard_ms: u16,
}

impl Autopilot {
    /// No autopilot.
    pub const NONE: Self = Self { id: None, commander: 0, heard_ms: 0 };

    /// True if there is an autopilot.
    pub fn is_present(&self) -> bool {
        self.id.is_some()
    }

    /// Takes note of a valid command from `source`.
    #[inline(always)]
    pub fn commanded_by(&mut self, source: NodeId, now_ms: u16) {
        *self = Self { id: Some(source), commander: source.get(), heard_ms: now_ms };
    }

    /// Takes note of a NodeStatus from `source`. Returns true if it is the autopilot's.
    pub fn is_status_of(&mut self, source: NodeId, now_ms: u16) -> bool {
        let is_better = match self.id {
            None => true,
            Some(id) => id == source || self.commander == 0 && source < id,
        };
        if is_better {
            self.id = Some(source);
            self.heard_ms = now_ms;
        }
        is_better
    }

    /// The node that sent the last valid command, or 0.
    pub fn commander(&self) -> u8 {
        self.commander
    }

    /// Forgets an autopilot that is offline.
    pub fn tick(&mut self, now_ms: u16) {
        if now_ms.wrapping_sub(self.heard_ms) > OFFLINE_TIMEOUT_MS {
            *self = Self { heard_ms: now_ms, ..Self::NONE };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(id: u8) -> NodeId {
        NodeId::new(id).unwrap()
    }

    #[test]
    fn before_any_command_the_lowest_node_id_is_the_autopilot() {
        let mut autopilot = Autopilot::NONE;
        assert!(autopilot.is_status_of(node(127), 0), "the only one so far");
        assert!(autopilot.is_status_of(node(10), 1));
        assert!(!autopilot.is_status_of(node(127), 2));
        assert!(!autopilot.is_status_of(node(42), 3));
        assert!(autopilot.is_status_of(node(10), 4));
    }

    #[test]
    fn who_commands_is_the_autopilot_whatever_its_id() {
        let mut autopilot = Autopilot::NONE;
        assert!(autopilot.is_status_of(node(1), 0));
        autopilot.commanded_by(node(10), 1);
        assert!(!autopilot.is_status_of(node(1), 2));
        assert!(autopilot.is_status_of(node(10), 3));
    }

    #[test]
    fn three_seconds_of_silence_make_room_for_another() {
        let mut autopilot = Autopilot::NONE;
        autopilot.commanded_by(node(10), 0);
        assert!(autopilot.is_status_of(node(10), 60_000));
        autopilot.tick(60_000u16.wrapping_add(3000));
        assert!(autopilot.is_present());
        autopilot.tick(60_000u16.wrapping_add(3001));
        assert!(!autopilot.is_present());
        assert!(autopilot.is_status_of(node(42), 0));
    }
}
