//! When the node sends its messages: their order, rates and transfer IDs.

use dronecan_wire::Tail;

use crate::tables::parameters::Parameters;
use crate::tables::publication::{COUNT, Publication, WHEN, When, for_published, paces};

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

/// The bits of [`Due`].
type Bits = <() as Width<{ COUNT > 8 }>>::Bits;

/// An integer with a bit for each message.
trait Width<const IS_WIDE: bool> {
    type Bits;
}

impl Width<false> for () {
    type Bits = u8;
}

impl Width<true> for () {
    type Bits = u16;
}

const _: () = assert!(COUNT <= Bits::BITS as usize, "each has a bit of `Due`");

/// A set of messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Due(Bits);

impl Due {
    #[inline(always)]
    const fn bit(publication: Publication) -> Bits {
        if publication.place() == Publication::NONE.place() { 0 } else { 1 << publication.place() }
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
}

/// Order and rates of the rows of the table.
macro_rules! publish {
    ($(if $if:meta {
        $($(#[doc = $doc:literal])*
        $name:ident = $type:path, $form:ident, $len:expr, $when:expr $(, $needs:ident)?
            => $put:ident $(. $method:ident)?;)*
    })*) => {
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

        /// The messages that need no temperature sensor.
        const WITHOUT_SENSOR: Due = {
            let mut due = Due(0);
            $($(#[cfg($if)] if !Publication::$name.needs_sensor() {
                due.0 |= Due::bit(Publication::$name);
            })*)*
            due
        };

        impl Publisher {
            /// Makes the messages with a rate due.
            #[inline(always)]
            fn pace_all(&mut self, passed_ms: u8, parameters: &Parameters) {
                $($(#[cfg($if)]
                if let When::Rate(parameter) =
                    const { &WHEN[Publication::$name.place() as usize] }
                {
                    let place = const {
                        paces(&WHEN.split_at(Publication::$name.place() as usize).0)
                    };
                    let rate = parameters.get(*parameter) as u8;
                    self.pace(Publication::$name, place, passed_ms, rate);
                })*)*
            }
        }
    };
}

for_published!(publish);

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

    /// Makes a status due, without the minimum time.
    pub fn publish_status(&mut self, now_ms: u16) {
        self.status_sent_ms = now_ms.wrapping_sub(MIN_STATUS_PERIOD_MS);
        self.publish(Publication::NodeStatus);
    }

    /// Makes a message due.
    #[inline(never)]
    pub fn publish(&mut self, publication: Publication) {
        self.due.0 |= Due::bit(publication);
    }

    /// Makes a message no longer due.
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
                due = due.only(WITHOUT_SENSOR);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_go_in_the_order_of_the_table() {
        let mut publisher = Publisher::new();
        publisher.publish_status(0);
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
}
