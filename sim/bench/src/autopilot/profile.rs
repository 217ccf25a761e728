//! Profiles of common flight controllers: the IDs, priorities and rates of their messages.
//!
//! Sources: recordings of ArduPlane 4.7.0-dev's software in the loop (tests/data/ardupilot);
//! ArduPilot, libraries/AP_DroneCAN/AP_DroneCAN.cpp at 03337782 (SRV_send_actuator, SRV_send_esc,
//! safety_state_send, init); PX4, src/drivers/uavcan/actuators/servo.cpp at f929353e, esc.cpp at
//! 000f5fdb, arming_status.cpp at 2a26f9a6, safety_state.cpp at 25ab311a and uavcan_main.cpp at
//! 011a4138, rgbled.cpp at 06e75a6d; a recording of PX4's driver of August 2026 (tests/data/px4);
//! libuavcan's global_time_sync_master.hpp; priorities of libcanard's canard.h.

use super::CommandType;
use crate::dronecan::{Dialect, NodeId};
use crate::{Cycles, F_CPU_HZ};
use std::fmt;

/// The flight controller that an autopilot imitates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Profile {
    /// No particular one: sends its status, and one command of any type in each message.
    #[default]
    Plain,
    /// The autopilot of the thesis: like plain, but with the thesis's own commands.
    Thesis,
    /// ArduPilot: 15 commands in each message, for actuators 1 to 15, -1 to +1; ArmingStatus,
    /// SafetyState, NotifyState, GetEscID and GetNodeInfo.
    Ardupilot,
    /// ArduPilot with the option to command pulse widths (CAN_Dn_UC_OPTION, bit 4).
    ArdupilotPwm,
    /// PX4: 15 commands in each message, for actuators 0 to 14, -1 to +1 (before June 2026 eight:
    /// `servos`); ArmingStatus, SafetyState, GlobalTimeSync, hardpoint.Command, BasicID and
    /// LightsCommand.
    Px4,
    /// No autopilot: only other programs command the node.
    None,
}

/// Values of SafetyState: the outputs are disabled, enabled.
const SAFETY_ON: u8 = 0;
const SAFETY_OFF: u8 = 255;

/// First ID and number of the actuators that a profile commands with one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Array {
    pub first: u8,
    pub count: u8,
}

/// Command for motors of a profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Motors {
    pub priority: u8,
    /// Lowest command while armed.
    pub idle: i16,
}

impl Profile {
    /// Usual node ID.
    pub fn node_id(self) -> NodeId {
        let id = match self {
            Profile::Ardupilot | Profile::ArdupilotPwm => 10,
            _ => 1,
        };
        NodeId::new(id).expect("a node ID")
    }

    /// Name in the GetNodeInfo response.
    pub(super) fn name(self) -> &'static str {
        match self {
            Profile::Ardupilot | Profile::ArdupilotPwm => "org.ardupilot:0",
            Profile::Px4 => "org.pixhawk.pixhawk",
            _ => "org.example.autopilot",
        }
    }

    /// The actuators whose commands are in one message; `None` if each message has one command.
    pub(super) fn array(self) -> Option<Array> {
        match self {
            Profile::Ardupilot | Profile::ArdupilotPwm => Some(Array { first: 1, count: 15 }),
            Profile::Px4 => Some(Array { first: 0, count: 15 }),
            _ => None,
        }
    }

    /// True if one message commands all actuators.
    pub fn commands_several(self) -> bool {
        self.array().is_some()
    }

    /// IDs of the actuators that the profile can command.
    pub fn actuators(self) -> std::ops::RangeInclusive<u8> {
        match self.array() {
            Some(Array { first, count }) => first..=first + count - 1,
            None => 0..=255,
        }
    }

    /// Command types in a dialect, the usual one first; empty if the profile does not support the
    /// dialect.
    pub fn command_types(self, dialect: Dialect) -> &'static [CommandType] {
        use CommandType::{Position, Pwm, Thesis, Unitless};
        match (self, dialect) {
            (Profile::Thesis, _) => &[Thesis],
            (Profile::Plain | Profile::None, Dialect::V0) => &[Unitless, Position, Pwm, Thesis],
            // A command of the draft has no unit.
            (Profile::Plain | Profile::None, Dialect::Draft) => &[Unitless, Thesis],
            (Profile::Ardupilot | Profile::Px4, Dialect::V0) => &[Unitless],
            (Profile::ArdupilotPwm, Dialect::V0) => &[Pwm],
            (Profile::Ardupilot | Profile::ArdupilotPwm | Profile::Px4, Dialect::Draft) => &[],
        }
    }

    /// Most motors that the profile can command: for ArduPilot the elements of a RawCommand, for
    /// PX4 its CONNECTED_ESC_MAX; 0 for profiles that do not send ArmingStatus.
    pub fn motors_max(self) -> u8 {
        match self {
            Profile::Ardupilot | Profile::ArdupilotPwm => 20,
            Profile::Px4 => 12,
            Profile::Plain | Profile::Thesis | Profile::None => 0,
        }
    }

    /// Command for motors. ArduPilot's priority is one above that of its ArrayCommand, PX4's is the
    /// highest. PX4 keeps motors turning while armed (UAVCAN_EC_MINn 1).
    pub(super) fn motors(self) -> Option<Motors> {
        match self {
            Profile::Ardupilot | Profile::ArdupilotPwm => Some(Motors { priority: 7, idle: 0 }),
            Profile::Px4 => Some(Motors { priority: 0, idle: 1 }),
            Profile::Plain | Profile::Thesis | Profile::None => None,
        }
    }

    pub(super) fn status_priority(self) -> u8 {
        match self {
            Profile::Ardupilot | Profile::ArdupilotPwm => 31,
            _ => 16,
        }
    }

    pub(super) fn command_priority(self) -> u8 {
        match self {
            Profile::Px4 => 6,
            _ => 8,
        }
    }

    /// Period and priority of ArmingStatus. PX4 looks for a change ten times a second, and its
    /// commander publishes the state twice a second.
    pub(super) fn arming(self) -> Option<(Cycles, u8)> {
        match self {
            Profile::Ardupilot | Profile::ArdupilotPwm => Some((F_CPU_HZ / 2, 24)),
            Profile::Px4 => Some((F_CPU_HZ / 2, 16)),
            _ => None,
        }
    }

    /// True if the profile sends SafetyState with ArmingStatus.
    pub(super) fn has_safety_switch(self) -> bool {
        matches!(self, Profile::Ardupilot | Profile::ArdupilotPwm | Profile::Px4)
    }

    /// SafetyState of a vehicle, `safe` if its safety switch is on. PX4 sends "on" unless armed.
    pub(super) fn safety_state(self, armed: bool, safe: bool) -> u8 {
        if safe || self == Profile::Px4 && !armed { SAFETY_ON } else { SAFETY_OFF }
    }

    /// Period and priority of NotifyState: heading and state of the vehicle, for its lights.
    pub(super) fn notify(self) -> Option<(Cycles, u8)> {
        self.is_ardupilot().then_some((F_CPU_HZ / 20, 24))
    }

    /// Period and priority of GetEscID, with which ArduPilot looks for motor controllers of
    /// Hobbywing while it is disarmed.
    pub(super) fn esc_id(self) -> Option<(Cycles, u8)> {
        self.is_ardupilot().then_some((F_CPU_HZ, 16))
    }

    /// Period of GetNodeInfo requests to the known nodes, one after the other, with which ArduPilot
    /// verifies that no node has another one's ID.
    pub(super) fn verify_period(self) -> Option<Cycles> {
        self.is_ardupilot().then_some(5 * F_CPU_HZ)
    }

    /// Period and priority of GlobalTimeSync.
    pub(super) fn time_sync(self) -> Option<(Cycles, u8)> {
        (self == Profile::Px4).then_some((F_CPU_HZ, 1))
    }

    /// Priority of hardpoint.Command, once a second: PX4 releases the gripper from its start.
    pub(super) fn hardpoint_priority(self) -> Option<u8> {
        (self == Profile::Px4).then_some(24)
    }

    /// Priority of BasicID, once a second: who the vehicle is.
    pub(super) fn identity_priority(self) -> Option<u8> {
        (self == Profile::Px4).then_some(16)
    }

    /// Period and priority of LightsCommand.
    pub(super) fn lights(self) -> Option<(Cycles, u8)> {
        (self == Profile::Px4).then_some((F_CPU_HZ / 10, 31))
    }

    /// True if the profile reads parameters of nodes by name.
    pub fn reads_parameters(self) -> bool {
        self.is_ardupilot()
    }

    fn is_ardupilot(self) -> bool {
        matches!(self, Profile::Ardupilot | Profile::ArdupilotPwm)
    }

    /// Priority of GetNodeInfo requests to new nodes; `None` if the profile sends none.
    pub(super) fn request_priority(self) -> Option<u8> {
        match self {
            Profile::Ardupilot | Profile::ArdupilotPwm => Some(16),
            Profile::Px4 => Some(30),
            _ => None,
        }
    }
}

impl fmt::Display for Profile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Profile::Plain => "autopilot",
            Profile::Thesis => "autopilot of the thesis",
            Profile::Ardupilot | Profile::ArdupilotPwm => "ArduPilot",
            Profile::Px4 => "PX4",
            Profile::None => "no autopilot",
        })
    }
}
