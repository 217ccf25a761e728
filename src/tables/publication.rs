//! The table of the messages that the node sends. A row has all that depends on the message: its
//! type, the length of its payload, when it is sent, and the name of the method that puts the
//! payload, which `node::dispatch` calls.

#[allow(unused_imports, reason = "the draft has no type of v0")]
use dronecan_wire::types::{self, Message};

use super::parameters::Parameter;
#[allow(unused_imports, reason = "the draft has a measurement of its own")]
use super::types::{DRAFT_MEASUREMENT, NODE_STATUS};

/// When a message is sent.
#[allow(dead_code, reason = "a build may have no message with a rate")]
pub enum When {
    /// As often as the parameter says, in times a second.
    Rate(Parameter),
    /// On an event.
    Event,
}

/// What the rows of [`for_published`] are.
macro_rules! publications {
    ($(if $if:meta {
        $($(#[doc = $doc:literal])*
        $name:ident = $type:path, $form:ident, $len:expr, $when:expr $(, $needs:ident)?
            => $put:ident $(. $method:ident)?;)*
    })*) => {
        /// A message that the node sends. Those of a part that the build leaves out are never sent.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct Publication(u8);

        numbered! { Publication, Self::NONE; $(if $if { $($(#[doc = $doc])* $name;)* })* }

        /// The data type of each message.
        const TYPES: &[Message] = &[$($(#[cfg($if)] $type,)*)*];

        /// When each message is sent.
        pub const WHEN: &[When] = &[$($(#[cfg($if)] { use When::*; $when },)*)*];

        /// True for each message that needs the temperature sensor.
        const NEEDS_SENSOR: &[bool] =
            &[$($(#[cfg($if)] publications!(@needs $($needs)?),)*)*];

        /// The greatest length of each payload, in bytes.
        const LENGTHS: &[u8] = &[$($(#[cfg($if)] $len,)*)*];

        impl Publication {
            /// The data type ID.
            pub const fn data_type(self) -> u16 {
                $($(#[cfg($if)] if self.0 == Self::$name.0 {
                    return $type.id;
                })*)*
                0
            }

            /// The initial CRC of a transfer of several frames. 0 if no transfer has more than one
            /// frame.
            pub const fn seed(self) -> u16 {
                $($(#[cfg($if)] if publications!(@is_long $form) && self.0 == Self::$name.0 {
                    return $type.seed;
                })*)*
                0
            }

            /// The place of its transfer IDs. Messages of the same type share them.
            pub const fn counter(self) -> u8 {
                $($(#[cfg($if)] if const { first_of_type(Self::$name) != Self::$name.0 }
                    && self.0 == Self::$name.0
                {
                    return const { first_of_type(Self::$name) };
                })*)*
                self.0
            }
        }
    };
    (@needs sensor) => { true };
    (@needs) => { false };
    (@is_long long) => { true };
    (@is_long short) => { false };
}

/// Gives the rows to the macro with this name. This module makes the messages of them,
/// [`publisher`](crate::node::publisher) their order and rates, and `node::dispatch` the calls of
/// their methods.
///
/// The rows are in groups, `if condition { rows }`, in the order in which messages leave when
/// several are due. A row is
///
/// `name = type, form, greatest length in bytes, when, sensor => method;`
///
/// where `sensor` stands only in the row of a message that needs the temperature sensor, and the
/// method is `group.method` if it is of a group of fields of the node. A transfer
/// of the form `short` has one frame. The method puts the payload, and returns false if there is
/// none to send now.
macro_rules! for_published {
    ($make:ident) => {
        $make! {
            if all() {
                /// uavcan.protocol.NodeStatus
                NodeStatus = NODE_STATUS, short, 7, Event => put_status;
            }
            if feature = "draft" {
                /// The thesis's measurement: the temperature in degrees Celsius.
                DegreesCelsius = DRAFT_MEASUREMENT, short, 1, Event, sensor
                    => sensors.put_degrees_celsius;
                /// The thesis's measurement: the presses of the button.
                Presses = DRAFT_MEASUREMENT, short, 1, Event => sensors.put_presses;
            }
            if feature = "standard" {
                /// uavcan.equipment.actuator.Status
                ActuatorStatus = types::ACTUATOR_STATUS, long, 8, Rate(Parameter::TelemRate)
                    => put_actuator_status;
            }
            if not(feature = "draft") {
                /// uavcan.equipment.device.Temperature
                Temperature = types::DEVICE_TEMPERATURE, short, 5, Rate(Parameter::TempRate), sensor
                    => sensors.put_temperature;
            }
            if feature = "stats" {
                /// dronecan.protocol.CanStats
                CanStats = types::CAN_STATS, long, 25, Rate(Parameter::StatsRate)
                    => record.put_can_stats;
            }
            if all(feature = "button", not(feature = "draft")) {
                /// uavcan.protocol.debug.KeyValue, with the presses of the button.
                KeyValue = types::KEY_VALUE, short, 7, Event => sensors.put_key_value;
                /// ardupilot.indication.Button, ten times a second while the button is pressed.
                Button = types::INDICATION_BUTTON, short, 2, Event => sensors.put_button;
            }
            if feature = "log" {
                /// uavcan.protocol.debug.LogMessage
                LogMessage = types::LOG_MESSAGE, long, 34, Event => put_log_message;
            }
            if feature = "tunnel" {
                /// uavcan.tunnel.Targetted, with characters of the serial monitor.
                Targetted = types::TUNNEL_TARGETTED, long, 25, Event => console.put_targetted;
            }
            if feature = "outputs" {
                /// uavcan.protocol.debug.KeyValue, with the outputs in failsafe.
                FailsafeOutputs = types::KEY_VALUE, short, 6, Event => control.put_failsafe_outputs;
            }
            if feature = "power" {
                /// uavcan.equipment.power.CircuitStatus
                CircuitStatus = types::CIRCUIT_STATUS, short, 7, Rate(Parameter::PwrRate)
                    => sensors.put_circuit_status;
            }
            if feature = "relay" {
                /// uavcan.equipment.hardpoint.Status
                HardpointStatus = types::HARDPOINT_STATUS, short, 7,
                    Rate(Parameter::RelayRate) => control.put_hardpoint_status;
            }
            if feature = "battery" {
                /// uavcan.equipment.power.BatteryInfo
                BatteryInfo = types::BATTERY_INFO, long, 23, Rate(Parameter::BattRate)
                    => sensors.put_battery_info;
            }
            if feature = "rpm" {
                /// dronecan.sensors.rpm.RPM
                Rpm = types::RPM, short, 7, Rate(Parameter::RpmRate) => sensors.put_rpm;
            }
            if feature = "allocation" {
                /// uavcan.protocol.dynamic_node_id.Allocation
                Allocation = types::ALLOCATION, short, 7, Event => put_allocation;
            }
        }
    };
}
pub(crate) use for_published;

for_published!(publications);

impl Publication {
    /// No message.
    pub const NONE: Self = Self(0xFF);

    /// The message with the presses of the button: each dialect has its own.
    pub const PRESSES: Self =
        if Self::Presses.0 == Self::NONE.0 { Self::KeyValue } else { Self::Presses };

    /// The place of its row in the table; 0xFF for none.
    pub const fn place(self) -> u8 {
        self.0
    }

    /// True if it is sent only while the temperature sensor gives a temperature.
    pub const fn needs_sensor(self) -> bool {
        NEEDS_SENSOR[self.0 as usize]
    }

    /// The greatest length of its payload, in bytes.
    pub const fn longest(self) -> u8 {
        LENGTHS[self.0 as usize]
    }

    /// True for a message that a node without an ID sends.
    #[inline(always)]
    pub fn is_anonymous(self) -> bool {
        Self::Allocation != Self::NONE && self == Self::Allocation
    }
}

/// The longest payload of a message, in bytes.
pub const LONGEST: usize = {
    let (mut longest, mut n) = (0, 0);
    while n < LENGTHS.len() {
        if LENGTHS[n] as usize > longest {
            longest = LENGTHS[n] as usize;
        }
        n += 1;
    }
    longest
};

/// The number of the first message with the type of this one.
const fn first_of_type(publication: Publication) -> u8 {
    let mut n = 0;
    while TYPES[n].id != TYPES[publication.0 as usize].id {
        n += 1;
    }
    n as u8
}

/// The number of messages with a rate.
pub const fn paces(when: &[When]) -> usize {
    let (mut count, mut n) = (0, 0);
    while n < when.len() {
        count += matches!(when[n], When::Rate(_)) as usize;
        n += 1;
    }
    count
}

/// The number of messages.
pub const COUNT: usize = TYPES.len();

#[cfg(test)]
impl Publication {
    /// All messages, in the order of the table.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..COUNT as u8).map(Self)
    }
}
