//! If the vehicle is armed, by the ArmingStatus of the autopilot.

use dronecan_wire::NodeId;

use crate::tables::parameters::{Parameter, Parameters};

/// The vehicle counts as disarmed after this time without an ArmingStatus, or up to a second
/// longer, in seconds. ArduPilot sends two a second.
const TIMEOUT_S: i8 = 4;

/// Beginnings of a second in this time at most.
const SECONDS: i8 = TIMEOUT_S + 1;

/// ArmingStatus.status: fully armed (DSDL uavcan/equipment/safety/1100.ArmingStatus.uavcan).
const FULLY_ARMED: u8 = 255;

/// False: the last commander's status counts for all.
pub const IS_BY_SOURCE: bool = false;

/// The arming of the vehicle.
pub struct Arming {
    /// Beginnings of a second until the vehicle no longer counts as armed. Less than 0: until
    /// it no longer counts that it was said to be disarmed.
    armed_s: i8,
}

impl Arming {
    /// Disarmed.
    pub const fn new() -> Self {
        Self { armed_s: 0 }
    }

    /// Acts on the status of an ArmingStatus. True: it is kept.
    pub fn act_on_status(&mut self, _id: u8, status: u8) -> bool {
        self.armed_s = if status == FULLY_ARMED { SECONDS } else { -SECONDS };
        true
    }

    /// Nothing: the last commanders' status counts.
    pub fn expect(&mut self, _source: NodeId) {}

    /// False: the same.
    pub fn expects(&self, _id: u8) -> bool {
        false
    }

    /// True if the last ArmingStatus said that the vehicle is armed.
    pub fn is_armed(&self) -> bool {
        self.armed_s > 0
    }

    /// True if ARM_REQ requires an armed vehicle, and the vehicle is disarmed.
    #[inline(never)]
    pub fn is_disarmed(&self, parameters: &Parameters) -> bool {
        self.armed_s <= 0 && parameters.is_on(Parameter::ArmReq)
    }

    /// The same as [`is_armed`](Self::is_armed).
    pub fn is_armed_by(&self, _id: u8) -> bool {
        self.is_armed()
    }

    /// The same as [`is_disarmed`](Self::is_disarmed).
    pub fn is_disarmed_by(&self, _id: u8, parameters: &Parameters) -> bool {
        self.is_disarmed(parameters)
    }

    /// False: the last status counts for all.
    pub fn is_only_armed_by_others(&self, _id: u8) -> bool {
        false
    }

    /// True if an ArmingStatus that still counts says that the vehicle is disarmed.
    pub fn is_said_disarmed(&self) -> bool {
        self.armed_s < 0
    }

    /// Counts down the timeout. Call once a second.
    pub fn second(&mut self) {
        match self.armed_s {
            0 => {}
            disarmed if disarmed < 0 => self.armed_s = disarmed.wrapping_add(1),
            armed => self.armed_s = armed.wrapping_sub(1),
        }
    }
}
