//! When the node sends its [`messages`](super::messages): their order, rates and transfer IDs.

use dronecan_wire::Tail;
#[allow(unused_imports, reason = "the draft has no type of v0")]
use dronecan_wire::types::{self, Message};

use super::Node;
use super::health::CanCounters;
use super::parameters::{Parameter, Parameters};
use crate::dialect;
use due::Due;

mod due;

/// The longest time between two statuses, in milliseconds (DSDL 341.NodeStatus.uavcan,
/// MAX_BROADCASTING_PERIOD_MS).
const MAX_BROADCASTING_PERIOD_MS: u16 = 1000;

/// The shortest time between two statuses, in milliseconds, at any rate of the autopilot's
/// statuses.
const MIN_STATUS_PERIOD_MS: u16 = 500;

/// Extra time to wait for the autopilot's status, in milliseconds. An autopilot that sends every
/// 1000 ms sometimes takes 1001. Without the extra time its status would come just after the node's
/// own.
const AUTOPILOT_GRACE_MS: u16 = 25;

/// When a message is sent.
#[allow(dead_code, reason = "a build may have no message with a rate")]
enum When {
    /// So many times a second as the parameter says.
    Rate(Parameter),
    /// On an event.
    Event,
}

/// A table of groups, `if condition { rows }`, in the order in which messages leave when several
/// are due. A row is `name = type, form, greatest length in bytes, when => method;`. A transfer of
/// the form `short` has one frame. The method puts the payload, and returns false if there is none
/// to send now.
macro_rules! publications {
    ($(if $if:meta {
        $($(#[doc = $doc:literal])*
        $name:ident = $type:path, $form:ident, $len:expr, $when:expr => $put:ident;)*
    })*) => {
        #[repr(u8)]
        enum Place {
            $($(#[cfg($if)] $name,)*)*
        }

        /// A message that the node sends. Those of a part that the build leaves out are never sent.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct Publication(u8);

        #[allow(non_upper_case_globals, reason = "they read as the variants of an enumeration")]
        impl Publication {
            $($(
                $(#[doc = $doc])*
                #[cfg($if)]
                pub const $name: Self = Self(Place::$name as u8);
                $(#[doc = $doc])*
                #[cfg(not($if))]
                pub const $name: Self = Self::NONE;
            )*)*
        }

        /// The data type of each message.
        const TYPES: &[Message] = &[$($(#[cfg($if)] $type,)*)*];

        /// When each message is sent.
        const WHEN: &[When] = &[$($(#[cfg($if)] { use When::*; $when },)*)*];

        /// The greatest length of each payload, in bytes.
        const LENGTHS: &[u8] = &[$($(#[cfg($if)] $len,)*)*];

        impl Publication {
            /// The data type ID.
            #[inline(always)]
            pub const fn data_type(self) -> u16 {
                $($(#[cfg($if)] if self.0 == Self::$name.0 {
                    return $type.id;
                })*)*
                0
            }

            /// The initial CRC of a transfer of several frames. 0 if no transfer has more than one
            /// frame.
            #[inline(always)]
            pub const fn seed(self) -> u16 {
                $($(#[cfg($if)] if publications!(@is_long $form) && self.0 == Self::$name.0 {
                    return $type.seed;
                })*)*
                0
            }

            /// The place of its transfer IDs. Messages of the same type share them.
            #[inline(always)]
            const fn counter(self) -> u8 {
                $($(#[cfg($if)] if const { first_of_type(Self::$name) != Self::$name.0 }
                    && self.0 == Self::$name.0
                {
                    return const { first_of_type(Self::$name) };
                })*)*
                self.0
            }
        }

        impl Due {
            /// The first message that is due.
            #[inline(always)]
            fn first(self) -> Option<Publication> {
                $($(#[cfg($if)] if self.has(Publication::$name) {
                    return Some(Publication::$name);
                })*)*
                None
            }
        }

        impl Publisher {
            /// Makes the messages with a rate due.
            #[inline(always)]
            fn pace_all(&mut self, passed_ms: u8, parameters: &Parameters) {
                $($(#[cfg($if)]
                if let When::Rate(parameter) = const { &WHEN[Place::$name as usize] } {
                    let place = const { paces(&WHEN.split_at(Place::$name as usize).0) };
                    let rate = parameters.get(*parameter) as u8;
                    self.pace(Publication::$name, place, passed_ms, rate);
                })*)*
            }
        }

        impl Node {
            /// Puts the payload of a message. Returns false if there is none to send now.
            #[inline(always)]
            pub(super) fn put<C: CanCounters>(
                &mut self,
                publication: Publication,
                counters: &C,
                now_ms: u16,
            ) -> bool {
                $($(#[cfg($if)] if publication.0 == Publication::$name.0 {
                    return self.$put(counters, now_ms);
                })*)*
                false
            }
        }
    };
    (@is_long long) => { true };
    (@is_long short) => { false };
}

publications! {
    if all() {
        /// uavcan.protocol.NodeStatus
        NodeStatus = dialect::NODE_STATUS, short, 7, Event => put_status_message;
    }
    if feature = "draft" {
        /// The thesis's measurement: the temperature in degrees Celsius.
        DegreesCelsius = dialect::MEASUREMENT, short, 1, Event => put_degrees_celsius;
        /// The thesis's measurement: the presses of the button.
        Presses = dialect::MEASUREMENT, short, 1, Event => put_presses;
    }
    if feature = "standard" {
        /// uavcan.equipment.actuator.Status
        ActuatorStatus = types::ACTUATOR_STATUS, long, 8, Rate(Parameter::TelemRate)
            => put_actuator_status;
    }
    if not(feature = "draft") {
        /// uavcan.equipment.device.Temperature
        Temperature = types::DEVICE_TEMPERATURE, short, 5, Rate(Parameter::TempRate)
            => put_temperature;
    }
    if feature = "stats" {
        /// dronecan.protocol.CanStats
        CanStats = types::CAN_STATS, long, 25, Rate(Parameter::StatsRate) => put_can_stats;
    }
    if all(feature = "button", not(feature = "draft")) {
        /// uavcan.protocol.debug.KeyValue, with the presses of the button.
        KeyValue = types::KEY_VALUE, short, 7, Event => put_key_value;
        /// ardupilot.indication.Button, ten times a second while the button is pressed.
        Button = types::INDICATION_BUTTON, short, 2, Event => put_button;
    }
    if feature = "log" {
        /// uavcan.protocol.debug.LogMessage
        LogMessage = types::LOG_MESSAGE, long, crate::parts::log::LEN, Event => put_log_message;
    }
    if feature = "tunnel" {
        /// uavcan.tunnel.Targetted, with characters of the serial monitor.
        Targetted = types::TUNNEL_TARGETTED, long, 25, Event => put_targetted;
    }
    if feature = "outputs" {
        /// uavcan.protocol.debug.KeyValue, with the outputs in failsafe.
        FailsafeOutputs = types::KEY_VALUE, short, 6, Event => put_failsafe_outputs;
    }
    if feature = "power" {
        /// uavcan.equipment.power.CircuitStatus
        CircuitStatus = types::CIRCUIT_STATUS, short, 7, Rate(Parameter::PwrRate)
            => put_circuit_status;
    }
    if feature = "relay" {
        /// uavcan.equipment.hardpoint.Status
        HardpointStatus = types::HARDPOINT_STATUS, short, 7,
            Rate(Parameter::RelayRate) => put_hardpoint_status;
    }
    if feature = "battery" {
        /// uavcan.equipment.power.BatteryInfo
        BatteryInfo = types::BATTERY_INFO, long, 23, Rate(Parameter::BattRate) => put_battery_info;
    }
    if feature = "rpm" {
        /// dronecan.sensors.rpm.RPM
        Rpm = types::RPM, short, 7, Rate(Parameter::RpmRate) => put_rpm;
    }
    if feature = "allocation" {
        /// uavcan.protocol.dynamic_node_id.Allocation
        Allocation = types::ALLOCATION, short, 7, Event => put_allocation;
    }
}

impl Publication {
    /// No message.
    pub const NONE: Self = Self(0xFF);

    /// The message with the presses of the button: each dialect has its own.
    pub const PRESSES: Self =
        if Self::Presses.0 == Self::NONE.0 { Self::KeyValue } else { Self::Presses };

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
const fn paces(when: &[When]) -> usize {
    let (mut count, mut n) = (0, 0);
    while n < when.len() {
        count += matches!(when[n], When::Rate(_)) as usize;
        n += 1;
    }
    count
}

/// The number of messages.
const COUNT: usize = TYPES.len();

/// The messages that a node without an ID sends.
const WITHOUT_ID: Due = Due(Due::bit(Publication::Allocation));

/// When the node sends its messages.
pub struct Publisher {
    due: Due,
    /// For each message with a rate: progress to the next one, in thousandths of a period.
    pace: [u16; paces(WHEN)],
    transfer_ids: [u8; COUNT],
    /// Time when a status last became due, in milliseconds: at a status of the autopilot, or after
    /// too long without one.
    occasion_ms: u16,
    /// Time when the last status was sent, in milliseconds; while the controller has it, time when
    /// it was handed over.
    status_sent_ms: u16,
    is_status_in_controller: bool,
}

impl Publisher {
    /// No message due.
    pub const fn new() -> Self {
        Self {
            due: Due(0),
            pace: [0; paces(WHEN)],
            transfer_ids: [0; COUNT],
            occasion_ms: 0,
            status_sent_ms: 0,
            is_status_in_controller: false,
        }
    }

    /// Makes the first status due, without the minimum time.
    pub fn start(&mut self) {
        self.status_sent_ms = MIN_STATUS_PERIOD_MS.wrapping_neg();
        self.publish(Publication::NodeStatus);
    }

    /// Makes a message due.
    #[inline(never)]
    pub fn publish(&mut self, publication: Publication) {
        self.due.0 |= Due::bit(publication);
    }

    /// Makes a message no longer due.
    #[inline(always)]
    pub fn withdraw(&mut self, publication: Publication) {
        self.due = self.due.without(publication);
    }

    /// True if a message is due, even if it has to wait.
    #[inline(always)]
    pub fn is_due(&self) -> bool {
        self.due.0 != 0
    }

    /// Makes messages due by time. Call once for each `passed_ms` milliseconds.
    #[inline(always)]
    pub fn tick(
        &mut self,
        passed_ms: u8,
        now_ms: u16,
        has_autopilot: bool,
        parameters: &Parameters,
    ) {
        let grace_ms = if has_autopilot { AUTOPILOT_GRACE_MS } else { 0 };
        if now_ms.wrapping_sub(self.occasion_ms) >= MAX_BROADCASTING_PERIOD_MS + grace_ms {
            self.occasion_ms = now_ms;
            self.publish(Publication::NodeStatus);
        }
        self.pace_all(passed_ms, parameters);
    }

    /// Advances a message by `passed_ms` milliseconds. Makes it due `rate` times a second, at most
    /// 255.
    #[inline(never)]
    fn pace(&mut self, publication: Publication, n: usize, passed_ms: u8, rate: u8) {
        let pace = &mut self.pace[n];
        *pace += u16::from(rate) * u16::from(passed_ms);
        if *pace >= 1000 {
            *pace -= 1000;
            self.publish(publication);
        }
    }

    /// Takes note of the autopilot's status, which makes the node's own due.
    #[inline(always)]
    pub fn autopilot_status(&mut self, now_ms: u16) {
        self.occasion_ms = now_ms;
        // If the last status was too recent, `next` delays this one.
        self.publish(Publication::NodeStatus);
    }

    /// Removes the first message that is due and can be sent. Returns it with its transfer ID.
    #[inline(always)]
    pub fn next(
        &mut self,
        now_ms: u16,
        has_id: bool,
        has_temperature: bool,
    ) -> Option<(Publication, u8)> {
        let mut due = self.due;
        if !has_id {
            due = due.only(WITHOUT_ID);
        } else {
            due = due.without(Publication::Allocation);
            if self.is_status_in_controller
                || now_ms.wrapping_sub(self.status_sent_ms) < MIN_STATUS_PERIOD_MS
            {
                due = due.without(Publication::NodeStatus);
            }
            if !has_temperature {
                due = due.without(Publication::Temperature).without(Publication::DegreesCelsius);
            }
        }
        let publication = due.first()?;
        self.withdraw(publication);
        let transfer_id = &mut self.transfer_ids[usize::from(publication.counter())];
        let current = *transfer_id;
        *transfer_id = (current + 1) & Tail::TRANSFER_ID;
        Some((publication, current))
    }

    /// Notes that the controller took the last frame of a status.
    pub fn status_handed_over(&mut self, now_ms: u16) {
        self.is_status_in_controller = true;
        self.status_sent_ms = now_ms;
    }

    /// Notes that the controller has sent all its frames. So a status that waited in it for the bus
    /// was sent just now.
    pub fn controller_is_empty(&mut self, now_ms: u16) {
        if self.is_status_in_controller {
            self.is_status_in_controller = false;
            self.status_sent_ms = now_ms;
        }
    }
}

impl Default for Publisher {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
impl Publication {
    /// All messages, in the order of the table.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..COUNT as u8).map(Self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_go_in_the_order_of_the_table() {
        let mut publisher = Publisher::new();
        publisher.start();
        for publication in Publication::all() {
            publisher.publish(publication);
        }
        let order: Vec<Publication> = std::iter::from_fn(|| publisher.next(0, true, true))
            .map(|(publication, _)| publication)
            .collect();
        let expected: Vec<Publication> =
            Publication::all().filter(|&publication| !WITHOUT_ID.has(publication)).collect();
        assert_eq!(order, expected);
    }

    #[cfg(not(feature = "draft"))]
    #[test]
    fn a_message_with_a_rate_is_due_that_many_times_a_second() {
        for rate in [0, 1, 7, 50] {
            let mut publisher = Publisher::new();
            let mut count = 0;
            for _ in 0..10_000 {
                publisher.pace(Publication::NodeStatus, 0, 1, rate);
                count += u32::from(publisher.due.has(Publication::NodeStatus));
                publisher.withdraw(Publication::NodeStatus);
            }
            assert_eq!(count, 10 * u32::from(rate));
        }
    }
}
