//! Finds the autopilot among the nodes on the bus.
//!
//! ArduPilot is node 10 by default, PX4 and the thesis's autopilot are node 1, and on a bench a GUI
//! tool may command the servo. So the autopilot is the node that sent the last valid command: one
//! that was followed, or rejected only because the vehicle was disarmed. Before the first command
//! it is the lowest node ID that sends a NodeStatus, because flight controllers have low IDs and
//! tools have high ones. An autopilot that is silent for three to four seconds is offline: the
//! specification says three.

use dronecan_wire::NodeId;

/// A node is offline after three to four seconds of silence. (DSDL 341.NodeStatus.uavcan:
/// OFFLINE_TIMEOUT_MS is 3000.)
const OFFLINE_S: u8 = 4;

/// A node is one of two commanders for this time after its command, in seconds: more than two, and
/// at most three.
const RECENT_S: u8 = 3;

/// The autopilot, if there is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Autopilot {
    id: Option<NodeId>,
    /// The node that sent the last valid command, or 0. It is the autopilot even if its ID is not
    /// the lowest.
    commander: u8,
    /// Seconds until it is offline.
    online_s: u8,
    /// Seconds that its last valid command counts as recent.
    recent_s: u8,
    /// The commander before, if its turn ended in this second; or 0.
    other: u8,
}

impl Autopilot {
    /// No autopilot.
    pub const NONE: Self = Self { id: None, commander: 0, online_s: 0, recent_s: 0, other: 0 };

    /// True if there is an autopilot.
    pub fn is_present(&self) -> bool {
        self.id.is_some()
    }

    /// Takes note of a valid command from `source`. Returns true if the command before it was
    /// recent, and another node's.
    pub fn commanded_by(&mut self, source: NodeId) -> bool {
        let is_another = self.commander != source.get();
        let is_second = self.recent_s != 0 && is_another;
        if is_another {
            self.other = self.commander;
        }
        self.id = Some(source);
        self.commander = source.get();
        self.online_s = OFFLINE_S;
        self.recent_s = RECENT_S;
        is_second
    }

    /// Takes note of a NodeStatus or ArmingStatus from `source`. Returns true if it is the
    /// autopilot's, or that of a commander whose turn ended in this second: it need not come while
    /// its sender is the last.
    pub fn is_status_of(&mut self, source: NodeId) -> bool {
        let is_better = match self.id {
            None => true,
            Some(id) => id == source || self.commander == 0 && source < id,
        };
        if is_better {
            self.id = Some(source);
            self.online_s = OFFLINE_S;
        }
        is_better || self.other == source.get()
    }

    /// The node that sent the last valid command, or 0.
    pub fn commander(&self) -> u8 {
        self.commander
    }

    /// Forgets an autopilot that is offline. Call once a second.
    pub fn second(&mut self) {
        // Of a saturating subtraction LLVM 22 makes eight instructions in place of four.
        if self.recent_s != 0 {
            self.recent_s -= 1;
        }
        self.other = 0;
        if self.online_s != 0 {
            self.online_s -= 1;
        }
        if self.online_s == 0 {
            *self = Self::NONE;
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
    fn a_command_of_another_node_within_two_seconds_or_three_is_a_second_commander_s() {
        for (seconds, is_second) in [(0, true), (1, true), (2, true), (3, false), (4, false)] {
            let mut autopilot = Autopilot::NONE;
            assert!(!autopilot.commanded_by(node(10)));
            assert!(!autopilot.commanded_by(node(10)));
            for _ in 0..seconds {
                autopilot.is_status_of(node(10));
                autopilot.second();
            }
            assert_eq!(autopilot.commanded_by(node(11)), is_second, "{seconds}");
            assert_eq!(autopilot.commander(), 11);
        }
    }

    #[test]
    fn three_seconds_of_silence_make_room_for_another() {
        let mut autopilot = Autopilot::NONE;
        autopilot.commanded_by(node(10));
        for _ in 0..10 {
            autopilot.second();
            assert!(autopilot.is_status_of(node(10)));
        }
        for _ in 0..3 {
            autopilot.second();
            assert!(autopilot.is_present());
        }
        autopilot.second();
        assert!(!autopilot.is_present());
        assert!(autopilot.is_status_of(node(42)));
    }
}
