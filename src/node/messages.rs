//! The payloads of the node's messages.

use dronecan_wire::{Id, float16};
use mcp2515_ordered::Frame;

use super::health::CanCounters;
#[cfg(feature = "standard")]
use super::parameters::OutputParameter;
use super::parameters::Parameter;
use super::publisher::Publication;
use super::{Constants, Node, Sending};
#[cfg(feature = "draft")]
use super::{draft, health::Level};
use crate::monitor::Monitor;

/// Priority of periodic messages. ArduPilot's own peripherals use the same.
const PRIORITY_LOW: u8 = 24;

/// Priority of Allocation requests, as in the specification's example.
#[cfg(feature = "allocation")]
const PRIORITY_LOWER: u8 = 30;

/// NodeStatus mode: the node has measured no temperature yet.
const MODE_INITIALIZATION: u8 = 1;

impl Node {
    /// True if [`prepare`](Self::prepare) may have something to do.
    #[inline(always)]
    pub fn has_to_send(&self) -> bool {
        self.publisher.is_due() || self.outgoing.is_busy() || !self.services.is_empty()
    }

    /// Does one step towards the next frame. Returns false if there was nothing to do.
    #[inline(always)]
    pub fn prepare(
        &mut self,
        counters: &impl CanCounters,
        flash: impl Constants,
        monitor: &mut Monitor,
        now_ms: u16,
    ) -> bool {
        if self.outgoing.is_ready() {
            return false;
        }
        if self.outgoing.is_busy() {
            self.outgoing.step(&self.unique_id, flash);
            return true;
        }
        // Setting filters takes the controller off the bus and loses the frames that it has not
        // sent. So no new transfer begins before.
        if self.awaits_filters() {
            return false;
        }
        self.begin_message(counters, now_ms)
            || self.id != 0 && self.begin_reply(counters, flash, monitor)
    }

    /// True if a frame is ready.
    pub fn is_ready(&self) -> bool {
        self.outgoing.is_ready()
    }

    /// The frame that is ready.
    pub fn frame(&self) -> &Frame {
        &self.outgoing.frame
    }

    /// Notes that the controller took the frame.
    pub fn handed_over(&mut self, now_ms: u16) {
        if !self.outgoing.handed_over() {
            return;
        }
        self.health.transfers.sent();
        match self.sending {
            Sending::Status => self.publisher.status_handed_over(now_ms),
            Sending::Message => {}
            Sending::Reply => self.services.replied(now_ms),
        }
    }

    /// Notes that the controller has sent all its frames.
    pub fn controller_is_empty(&mut self, now_ms: u16) {
        self.publisher.controller_is_empty(now_ms);
    }

    /// Puts the payload of a NodeStatus, in the dialect of the current transfer.
    #[inline(never)]
    pub(super) fn put_status(&mut self) {
        let level = self.health.level(&self.parameters);
        let mode = if self.temperature.is_known() { 0 } else { MODE_INITIALIZATION };
        let [u0, u1, u2, u3] = self.uptime_sec.to_le_bytes();
        self.outgoing.put16(u16::from_le_bytes([u0, u1]));
        self.outgoing.put8(u2);
        #[cfg(feature = "draft")]
        if self.outgoing.is_draft() {
            // 28 bits of uptime, then the status: 0 is OK, 1 initialising, 2 warning, 3 critical.
            let status = match level {
                Level::Ok => mode,
                Level::Warning => 2,
                _ => 3,
            };
            self.outgoing.put8(u3 << 4 | status);
            return self.outgoing.put16(self.health.code());
        }
        self.outgoing.put8(u3);
        self.outgoing.put8((level as u8) << 6 | mode << 3);
        self.outgoing.put16(self.health.code());
    }

    /// Begins the first message that is due and can be sent. Returns false if there is none.
    #[inline(always)]
    fn begin_message(&mut self, counters: &impl CanCounters, now_ms: u16) -> bool {
        // The draft has no Allocation, so a node without an ID sends in v0.
        let is_draft = self.dialect.is_draft() && self.id != 0;
        let has_temperature = self.temperature.has_sensor();
        let Some((publication, transfer_id)) =
            self.publisher.next(now_ms, self.id != 0, has_temperature, is_draft)
        else {
            return false;
        };
        self.sending =
            if publication == Publication::NodeStatus { Sending::Status } else { Sending::Message };
        self.outgoing.clear(is_draft);
        #[allow(unused_mut, reason = "a build may have no anonymous message")]
        let mut id = Id::message(PRIORITY_LOW, publication.data_type(), self.id);
        match publication {
            Publication::NodeStatus => self.put_status(),
            Publication::DegreesCelsius => {
                self.outgoing.put8(self.temperature.celsius().clamp(0, 255) as u8)
            }
            #[cfg(feature = "standard")]
            Publication::ActuatorStatus => {
                let Some(output) = self.actuators.next_to_report() else { return false };
                self.outgoing.put8(self.parameters.of(output, OutputParameter::Id) as u8);
                self.outgoing.put16(self.actuators.position(output));
                // Force and speed are not measured.
                self.outgoing.put16(float16::NAN);
                self.outgoing.put16(float16::NAN);
                #[cfg(feature = "power")]
                self.outgoing.put8(self.power.rating_percent(output, &self.parameters));
                #[cfg(not(feature = "power"))]
                {
                    const POWER_UNKNOWN: u8 = 127;
                    self.outgoing.put8(POWER_UNKNOWN);
                }
            }
            Publication::Temperature => {
                self.outgoing.put16(self.parameters.get(Parameter::TempId));
                self.outgoing.put16(float16::from_fixed(self.temperature.kelvin_64ths(), 6));
                self.outgoing.put8(self.temperature.flags());
            }
            #[cfg(feature = "stats")]
            Publication::CanStats => {
                self.outgoing.put8(0);
                for n in 0..mcp2515_ordered::WORDS {
                    self.outgoing.put16(counters.word(n));
                }
            }
            // The draft has no KeyValue: the node sends the count as the thesis's measurement.
            #[cfg(feature = "button")]
            Publication::KeyValue if is_draft => self.outgoing.put8(self.button.count() as u8),
            #[cfg(feature = "button")]
            Publication::KeyValue => {
                let [high, low] = float16::to_float32(self.button.count());
                self.outgoing.put16(low);
                self.outgoing.put16(high);
                self.outgoing.put16(u16::from_le_bytes(*b"bt"));
                self.outgoing.put8(b'n');
            }
            #[cfg(feature = "tunnel")]
            Publication::Targetted => self.tunnel.take(now_ms, |byte| self.outgoing.put8(byte)),
            #[cfg(feature = "outputs")]
            Publication::FailsafeOutputs => {
                let [high, low] = float16::to_float32(self.actuators.failing().into());
                self.outgoing.put16(low);
                self.outgoing.put16(high);
                self.outgoing.put16(u16::from_le_bytes(*b"fs"));
            }
            #[cfg(feature = "power")]
            Publication::CircuitStatus if !self.power.is_known() => return false,
            #[cfg(feature = "power")]
            Publication::CircuitStatus => {
                self.outgoing.put16(self.parameters.get(Parameter::Pwr1Id));
                self.outgoing.put16(self.power.voltage());
                self.outgoing.put16(self.power.current());
                self.outgoing.put8(self.power.flags());
            }
            #[cfg(feature = "allocation")]
            Publication::Allocation => {
                self.allocation.ask(&self.unique_id, now_ms, |byte| self.outgoing.put8(byte));
                // The discriminator is 14 bits of the CRC, so that requests of different nodes have
                // different identifiers.
                id = Id::anonymous(
                    PRIORITY_LOWER,
                    Publication::Allocation.data_type(),
                    self.outgoing.sum() >> 1,
                );
            }
        }
        let _ = counters;
        #[cfg(feature = "draft")]
        if is_draft {
            let is_status = publication == Publication::NodeStatus;
            let upper = if is_status { draft::sent::NODE_STATUS } else { draft::sent::MEASUREMENT };
            self.outgoing.begin(draft::id(upper, self.id), transfer_id, 0);
            return true;
        }
        self.outgoing.begin(id.to_bytes(), transfer_id, publication.seed());
        true
    }
}
