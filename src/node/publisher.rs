//! When the node sends its messages: their order, rates and transfer IDs.
//! [`messages`](super::messages) has their payloads.

use dronecan_wire::Tail;
use dronecan_wire::types::{self, Message};

use super::parameters::{Parameter, Parameters};

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

/// The node sends the thesis's temperature once for this number of statuses from the autopilot.
const STATUSES_PER_DEGREES: u8 = 3;

/// A row is `name = type, form;`. A transfer of the form `short` has one frame.
macro_rules! publications {
    ($($(#[doc = $doc:literal])* $(#[cfg($if:meta)])? $name:ident = $type:path, $form:ident;)*) => {
        /// A message that the node sends.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Publication {
            $($(#[doc = $doc])* $(#[cfg($if)])? $name,)*
        }

        impl Publication {
            /// All messages, in the order in which the node sends them when several are due.
            pub const ALL: &[Self] = &[$($(#[cfg($if)])? Self::$name,)*];

            /// The data type ID.
            #[inline(always)]
            pub const fn data_type(self) -> u16 {
                match self {
                    $($(#[cfg($if)])? Self::$name => $type.id,)*
                }
            }

            /// The initial CRC of a transfer of several frames. 0 if no transfer has more than one frame.
            #[inline(always)]
            pub const fn seed(self) -> u16 {
                match self {
                    $($(#[cfg($if)])? Self::$name => publications!(@$form $type),)*
                }
            }
        }

        impl Due {
            /// The first message that is due.
            fn first(self) -> Option<Publication> {
                $($(#[cfg($if)])? if self.has(Publication::$name) {
                    return Some(Publication::$name);
                })*
                None
            }
        }
    };
    (@short $type:path) => { 0 };
    (@long $type:path) => { $type.seed };
}

/// The thesis's temperature. Its transfers have one frame, and no CRC.
const DEGREES_CELSIUS: Message = Message { id: 1112, seed: 0 };

publications! {
    /// uavcan.protocol.NodeStatus
    NodeStatus = types::NODE_STATUS, short;
    /// thesis.DegreesCelsius
    DegreesCelsius = DEGREES_CELSIUS, short;
    /// uavcan.equipment.actuator.Status
    #[cfg(feature = "standard")]
    ActuatorStatus = types::ACTUATOR_STATUS, long;
    /// uavcan.equipment.device.Temperature
    Temperature = types::DEVICE_TEMPERATURE, short;
    /// dronecan.protocol.CanStats
    #[cfg(feature = "stats")]
    CanStats = types::CAN_STATS, long;
    /// uavcan.protocol.debug.KeyValue, with the presses of the button.
    #[cfg(feature = "button")]
    KeyValue = types::KEY_VALUE, short;
    /// uavcan.tunnel.Targetted, with characters of the serial monitor.
    #[cfg(feature = "tunnel")]
    Targetted = types::TUNNEL_TARGETTED, long;
    /// uavcan.protocol.debug.KeyValue, with the outputs in failsafe.
    #[cfg(feature = "outputs")]
    FailsafeOutputs = types::KEY_VALUE, short;
    /// uavcan.equipment.power.CircuitStatus
    #[cfg(feature = "power")]
    CircuitStatus = types::CIRCUIT_STATUS, short;
    /// uavcan.protocol.dynamic_node_id.Allocation
    #[cfg(feature = "allocation")]
    Allocation = types::ALLOCATION, short;
}

/// Number of messages, each with its own transfer IDs.
const COUNT: usize = Publication::ALL.len();

/// The bits of [`Due`].
#[cfg(not(feature = "power"))]
type Bits = u8;
#[cfg(feature = "power")]
type Bits = u16;
const _: () = assert!(COUNT <= Bits::BITS as usize, "each has a bit of `Due`");

/// A set of messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Due(Bits);

impl Due {
    const fn bit(publication: Publication) -> Bits {
        1 << publication as u8
    }

    const fn has(self, publication: Publication) -> bool {
        self.0 & Self::bit(publication) != 0
    }

    const fn without(self, publication: Publication) -> Self {
        Self(self.0 & !Self::bit(publication))
    }

    /// The messages that are in both sets.
    const fn only(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// The set of these messages.
    const fn of(publications: &[Publication]) -> Self {
        let mut due = 0;
        let mut n = 0;
        while n < publications.len() {
            due |= Self::bit(publications[n]);
            n += 1;
        }
        Self(due)
    }
}

/// The messages that a node without an ID sends.
const WITHOUT_ID: Due = Due::of(&[
    #[cfg(feature = "allocation")]
    Publication::Allocation,
]);

/// The messages that a node sends in the draft of 2014.
#[cfg(feature = "draft")]
const IN_DRAFT: Due = Due::of(&[
    Publication::NodeStatus,
    Publication::DegreesCelsius,
    #[cfg(feature = "button")]
    Publication::KeyValue,
]);

/// Number of messages with a rate, in the order of [`Publisher::pace`].
const PACED: usize = 2 + STATS + cfg!(feature = "power") as usize;
const STATS: usize = cfg!(feature = "stats") as usize;

/// When the node sends its messages.
pub struct Publisher {
    due: Due,
    /// For each message with a rate: progress to the next one, in thousandths of a period.
    pace: [u16; PACED],
    transfer_ids: [u8; COUNT],
    /// Time when a status last became due, in milliseconds: at a status of the autopilot, or after
    /// too long without one.
    occasion_ms: u16,
    /// Time when the last status was sent, in milliseconds; while the controller has it, time when
    /// it was handed over.
    status_sent_ms: u16,
    is_status_in_controller: bool,
    /// Statuses of the autopilot since the thesis's temperature was last due.
    autopilot_statuses: u8,
}

impl Publisher {
    /// No message due.
    pub const fn new() -> Self {
        Self {
            due: Due(0),
            pace: [0; PACED],
            transfer_ids: [0; COUNT],
            occasion_ms: 0,
            status_sent_ms: 0,
            is_status_in_controller: false,
            autopilot_statuses: 0,
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
        self.pace(
            Publication::Temperature,
            0,
            passed_ms,
            parameters.get(Parameter::TempRate) as u8,
        );
        #[cfg(feature = "standard")]
        self.pace(
            Publication::ActuatorStatus,
            1,
            passed_ms,
            parameters.get(Parameter::TelemRate) as u8,
        );
        #[cfg(feature = "stats")]
        self.pace(Publication::CanStats, 2, passed_ms, parameters.get(Parameter::StatsRate) as u8);
        #[cfg(feature = "power")]
        self.pace(
            Publication::CircuitStatus,
            2 + STATS,
            passed_ms,
            parameters.get(Parameter::PwrRate) as u8,
        );
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
    pub fn autopilot_status(&mut self, now_ms: u16, wants_degrees: bool) {
        self.occasion_ms = now_ms;
        // If the last status was too recent, `next` delays this one.
        self.publish(Publication::NodeStatus);
        if wants_degrees {
            self.autopilot_statuses += 1;
            if self.autopilot_statuses == STATUSES_PER_DEGREES {
                self.autopilot_statuses = 0;
                self.publish(Publication::DegreesCelsius);
            }
        }
    }

    /// Takes the first message that is due and can be sent, and its transfer ID.
    #[inline(always)]
    pub fn next(
        &mut self,
        now_ms: u16,
        has_id: bool,
        has_temperature: bool,
        is_draft: bool,
    ) -> Option<(Publication, u8)> {
        let mut due = self.due;
        if !has_id {
            due = due.only(WITHOUT_ID);
        } else {
            #[cfg(feature = "allocation")]
            {
                due = due.without(Publication::Allocation);
            }
            if self.is_status_in_controller
                || now_ms.wrapping_sub(self.status_sent_ms) < MIN_STATUS_PERIOD_MS
            {
                due = due.without(Publication::NodeStatus);
            }
            if !has_temperature {
                due = due.without(Publication::Temperature).without(Publication::DegreesCelsius);
            }
            #[cfg(feature = "draft")]
            if is_draft {
                due = due.only(IN_DRAFT);
            }
        }
        let _ = is_draft;
        let publication = due.first()?;
        self.withdraw(publication);
        // In the draft both are the thesis's measurement, so they share their transfer IDs.
        #[cfg(all(feature = "draft", feature = "button"))]
        let counted = if is_draft && publication == Publication::KeyValue {
            Publication::DegreesCelsius
        } else {
            publication
        };
        #[cfg(not(all(feature = "draft", feature = "button")))]
        let counted = publication;
        // Both are KeyValues, so they share their transfer IDs.
        #[cfg(all(feature = "outputs", feature = "button"))]
        let counted =
            if counted == Publication::FailsafeOutputs { Publication::KeyValue } else { counted };
        let transfer_id = &mut self.transfer_ids[counted as usize];
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
mod tests {
    use super::*;

    #[test]
    fn messages_go_in_the_order_of_the_table() {
        let mut publisher = Publisher::new();
        publisher.start();
        for &publication in Publication::ALL {
            publisher.publish(publication);
        }
        let order: Vec<Publication> = std::iter::from_fn(|| publisher.next(0, true, true, false))
            .map(|(publication, _)| publication)
            .collect();
        let expected: Vec<Publication> = Publication::ALL
            .iter()
            .copied()
            .filter(|&publication| !WITHOUT_ID.has(publication))
            .collect();
        assert_eq!(order, expected);
    }

    #[test]
    fn a_message_with_a_rate_is_due_that_many_times_a_second() {
        for rate in [0, 1, 7, 50] {
            let mut publisher = Publisher::new();
            let mut count = 0;
            for _ in 0..10_000 {
                publisher.pace(Publication::Temperature, 0, 1, rate);
                count += u32::from(publisher.due.has(Publication::Temperature));
                publisher.withdraw(Publication::Temperature);
            }
            assert_eq!(count, 10 * u32::from(rate));
        }
    }
}
