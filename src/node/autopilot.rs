//! Which of the nodes on the bus is the autopilot.
//!
//! ArduPilot is node 10 unless told otherwise, PX4 and the thesis's autopilot are node 1, and a bench may command the servo
//! from a GUI tool. So the autopilot is the node that last gave an accepted command; before the first command, the
//! lowest node ID that sends its status, because flight controllers are numbered low and tools high. One that has been
//! silent for three seconds is gone, as the specification has it.

use crate::dronecan::NodeId;

/// A node that is silent for longer counts as gone, in milliseconds (DSDL 341.NodeStatus.uavcan, OFFLINE_TIMEOUT_MS).
const OFFLINE_TIMEOUT_MS: u16 = 3000;

/// The autopilot, if there is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Autopilot {
    id: Option<NodeId>,
    /// The node whose command was followed last, or 0. Then it is the autopilot, whatever the order of IDs.
    commander: u8,
    heard_ms: u16,
}

impl Autopilot {
    /// Nobody has been heard.
    pub const NONE: Self = Self { id: None, commander: 0, heard_ms: 0 };

    /// Whether there is one.
    pub fn is_present(&self) -> bool {
        self.id.is_some()
    }

    /// A command from `source` was accepted.
    #[inline(always)]
    pub fn commanded_by(&mut self, source: NodeId, now_ms: u16) {
        *self = Self { id: Some(source), commander: source.get(), heard_ms: now_ms };
    }

    /// A status of `source` came; whether it is the autopilot's.
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

    /// The node whose command was followed last, or 0.
    pub fn commander(&self) -> u8 {
        self.commander
    }

    /// Forgets an autopilot that has been silent for too long.
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
