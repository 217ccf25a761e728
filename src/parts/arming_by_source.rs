//! If the vehicle is armed, by the ArmingStatus of each node that commands an output. The statuses
//! of one node neither arm nor disarm the outputs of another.

use dronecan_wire::NodeId;

use crate::tables::parameters::{Parameter, Parameters};

/// What a status says counts for this time, or up to a second longer, in seconds. ArduPilot sends
/// two a second.
const TIMEOUT_S: u8 = 4;

/// Beginnings of a second in this time at most.
const SECONDS: u8 = TIMEOUT_S + 1;

/// The largest number of nodes whose vehicles are armed at the same time.
const SOURCES: usize = 4;

/// ArmingStatus.status: fully armed (DSDL uavcan/equipment/safety/1100.ArmingStatus.uavcan).
const FULLY_ARMED: u8 = 255;

/// True: the sender of a command decides if it is followed.
pub const IS_BY_SOURCE: bool = true;

/// A node whose status said that the vehicle is armed, or is to say so: its command was refused.
#[derive(Clone, Copy)]
struct Source {
    id: u8,
    /// Beginnings of a second until it no longer counts.
    armed_s: u8,
}

/// The arming of the vehicle, or of the vehicles of several commanders.
pub struct Arming {
    sources: [Source; SOURCES],
    /// The place that was given last to a node whose command was refused.
    expected: u8,
    /// Beginnings of a second until a status that said disarmed no longer counts.
    disarmed_s: u8,
}

impl Arming {
    /// Nobody has said anything.
    pub const fn new() -> Self {
        Self { sources: [Source { id: 0, armed_s: 0 }; SOURCES], expected: 0, disarmed_s: 0 }
    }

    /// A command of this node was refused because it has not armed: its ArmingStatus counts from
    /// now on, whoever else commands. Of nodes that have not armed, the newest four have a place.
    #[inline(never)]
    pub fn expect(&mut self, source: NodeId) {
        let id = source.get();
        if self.expects(id) {
            return;
        }
        for _ in 0..SOURCES {
            self.expected = (self.expected + 1) % SOURCES as u8;
            let place = &mut self.sources[usize::from(self.expected)];
            if place.armed_s == 0 {
                place.id = id;
                return;
            }
        }
    }

    /// True if this node has a place.
    #[inline(never)]
    pub fn expects(&self, id: u8) -> bool {
        id != 0 && self.sources.iter().any(|source| source.id == id)
    }

    /// Acts on the status of an ArmingStatus from this node. False: it is not kept, because four
    /// other nodes are armed.
    pub fn act_on_status(&mut self, id: u8, status: u8) -> bool {
        let is_armed = status == FULLY_ARMED;
        if !is_armed {
            self.disarmed_s = SECONDS;
        }
        // Its own place, or a free one. A node whose status still counts is never displaced,
        // because it may be commanding an output: a fifth waits until one of the four says disarmed
        // or nothing for four seconds.
        let mut place = None;
        for source in &mut self.sources {
            if source.id == id {
                place = Some(source);
                break;
            }
            if source.armed_s == 0 {
                place = Some(source);
            }
        }
        let Some(source) = place else { return !is_armed };
        *source = Source { id, armed_s: if is_armed { SECONDS } else { 0 } };
        true
    }

    /// True if the last status of a node said that the vehicle is armed.
    pub fn is_armed(&self) -> bool {
        self.sources.iter().any(|source| source.armed_s != 0)
    }

    /// True if the last status of this node said that the vehicle is armed.
    pub fn is_armed_by(&self, id: u8) -> bool {
        self.sources.iter().any(|source| source.id == id && source.armed_s != 0)
    }

    /// True if other nodes said last that the vehicle is armed, and this node did not.
    #[inline(never)]
    pub fn is_only_armed_by_others(&self, id: u8) -> bool {
        let mut is_armed = false;
        for source in &self.sources {
            if source.armed_s != 0 {
                if source.id == id {
                    return false;
                }
                is_armed = true;
            }
        }
        is_armed
    }

    /// True if a status that still counts says that the vehicle is disarmed, and none that it is
    /// armed.
    pub fn is_said_disarmed(&self) -> bool {
        self.disarmed_s != 0 && !self.is_armed()
    }

    /// True if ARM_REQ requires an armed vehicle, and no node says that it is.
    #[inline(never)]
    pub fn is_disarmed(&self, parameters: &Parameters) -> bool {
        !self.is_armed() && parameters.is_on(Parameter::ArmReq)
    }

    /// True if ARM_REQ requires an armed vehicle, and this node does not say that it is.
    #[inline(never)]
    pub fn is_disarmed_by(&self, id: u8, parameters: &Parameters) -> bool {
        parameters.is_on(Parameter::ArmReq) && !self.is_armed_by(id)
    }

    /// Counts down the timeouts. Call once a second.
    pub fn second(&mut self) {
        for source in &mut self.sources {
            source.armed_s = source.armed_s.saturating_sub(1);
        }
        self.disarmed_s = self.disarmed_s.saturating_sub(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_nodes_arm_and_a_fifth_waits_until_one_of_them_is_silent_or_disarmed() {
        let mut arming = Arming::new();
        for id in [10, 11, 12, 13, 14] {
            arming.act_on_status(id, FULLY_ARMED);
        }
        let armed = |arming: &Arming| [10, 11, 12, 13, 14].map(|id| arming.is_armed_by(id));
        assert_eq!(armed(&arming), [true, true, true, true, false]);
        arming.act_on_status(11, 0);
        arming.act_on_status(14, FULLY_ARMED);
        assert_eq!(armed(&arming), [true, false, true, true, true]);
        for _ in 0..SECONDS {
            assert_eq!(armed(&arming), [true, false, true, true, true]);
            arming.second();
            arming.act_on_status(14, FULLY_ARMED);
        }
        assert_eq!(armed(&arming), [false, false, false, false, true]);
        arming.act_on_status(11, FULLY_ARMED);
        assert_eq!(armed(&arming), [false, true, false, false, true]);
    }
}
