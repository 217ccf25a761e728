//! The payloads of the node's messages, and the way of a frame to the controller.

use dronecan_wire::{Id, float16};
use mcp2515_ordered::Frame;

use super::Node;
use super::outgoing::Sending;
use super::services::Response;
use crate::dialect;
use crate::hardware::CanCounters;
use crate::monitor::Monitor;
use crate::tables::Constants;
use crate::tables::parameters::{OutputParameter, Parameter};
use crate::tables::publication::Publication;

/// Priority of Allocation requests, as in the specification's example.
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
        if self.filters_s != 0 {
            return false;
        }
        self.begin_message(counters, now_ms)
            || self.id != 0
                && self.begin_response(&mut Response { now_ms, counters, flash, monitor })
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
    #[inline(always)]
    pub fn handed_over(&mut self, now_ms: u16) {
        if !self.outgoing.handed_over() {
            return;
        }
        self.stats.count_sent();
        match self.sending {
            Sending::Status => self.publisher.status_handed_over(now_ms),
            Sending::Message => {}
            Sending::Response => self.services.responded(now_ms),
        }
    }

    /// Notes that the controller has sent all its frames.
    pub fn controller_is_empty(&mut self, now_ms: u16) {
        self.publisher.controller_is_empty(now_ms);
    }

    /// Begins the first message that is due and can be sent. Returns false if there is none.
    #[inline(always)]
    fn begin_message(&mut self, counters: &impl CanCounters, now_ms: u16) -> bool {
        let Some((publication, transfer_id)) =
            self.publisher.next(now_ms, self.id != 0, self.temperature.has_sensor())
        else {
            return false;
        };
        self.outgoing.clear();
        if !self.put(publication, counters, now_ms) {
            return false;
        }
        self.sending =
            if publication == Publication::NodeStatus { Sending::Status } else { Sending::Message };
        let id = if publication.is_anonymous() {
            // The discriminator is 14 bits of the CRC, so that requests of different nodes have
            // different identifiers.
            let discriminator = self.outgoing.sum() >> 1;
            Id::anonymous(PRIORITY_LOWER, publication.data_type(), discriminator).to_bytes()
        } else {
            dialect::message_id(publication.data_type(), self.id)
        };
        self.outgoing.begin(id, transfer_id, publication.seed());
        true
    }

    /// Puts the payload of a NodeStatus.
    #[inline(never)]
    pub(super) fn put_status(&mut self, now_ms: u16) {
        let level = self.health.level(&self.parameters, self.outputs.excused(now_ms));
        let mode = if self.temperature.is_known() { 0 } else { MODE_INITIALIZATION };
        let outgoing = &mut self.outgoing;
        let code = self.health.code();
        let len = dialect::put_status(self.uptime_sec, level, mode, code, &mut |word| {
            outgoing.put16(word);
        });
        self.outgoing.payload.len = len;
    }
}

/// The payloads of the messages, which the table of sent types names. Each returns false if there
/// is nothing to send now.
#[allow(dead_code, reason = "a build may leave out the row that names one")]
impl Node {
    #[inline(always)]
    pub(super) fn put_status_message(&mut self, _: &impl CanCounters, now_ms: u16) -> bool {
        self.put_status(now_ms);
        true
    }

    #[inline(always)]
    pub(super) fn put_degrees_celsius(&mut self, _: &impl CanCounters, _now_ms: u16) -> bool {
        self.outgoing.put8(self.temperature.celsius().clamp(0, 255) as u8);
        true
    }

    #[inline(always)]
    pub(super) fn put_presses(&mut self, _: &impl CanCounters, _now_ms: u16) -> bool {
        self.outgoing.put8(self.button.count() as u8);
        true
    }

    #[inline(always)]
    pub(super) fn put_actuator_status(&mut self, _: &impl CanCounters, _now_ms: u16) -> bool {
        let Some(output) = self.outputs.next_to_report() else { return false };
        self.outgoing.put8(self.parameters.of(output, OutputParameter::Id) as u8);
        self.outgoing.put16(self.outputs.position(output));
        // Force and speed are not measured.
        self.outgoing.put16(float16::NAN);
        self.outgoing.put16(float16::NAN);
        self.outgoing.put8(self.power.rating_percent(output, &self.parameters));
        true
    }

    #[inline(always)]
    pub(super) fn put_temperature(&mut self, _: &impl CanCounters, _now_ms: u16) -> bool {
        self.outgoing.put16(self.parameters.get(Parameter::TempId));
        self.outgoing.put16(float16::from_fixed(self.temperature.kelvin_64ths(), 6));
        self.outgoing.put8(self.temperature.flags());
        true
    }

    #[inline(always)]
    pub(super) fn put_can_stats(&mut self, counters: &impl CanCounters, _now_ms: u16) -> bool {
        // The only interface.
        self.outgoing.put8(0);
        self.stats.put_can(counters, |word| self.outgoing.put16(word));
        true
    }

    #[inline(always)]
    pub(super) fn put_key_value(&mut self, _: &impl CanCounters, _now_ms: u16) -> bool {
        self.put_float32(self.button.count());
        self.outgoing.put16(u16::from_le_bytes(*b"bt"));
        self.outgoing.put8(b'n');
        true
    }

    #[inline(always)]
    pub(super) fn put_button(&mut self, _: &impl CanCounters, _now_ms: u16) -> bool {
        /// BUTTON_SAFETY.
        const SAFETY: u8 = 1;
        self.outgoing.put8(SAFETY);
        self.outgoing.put8(self.button.press_time_ds());
        true
    }

    #[inline(always)]
    pub(super) fn put_failsafe_outputs(&mut self, _: &impl CanCounters, _now_ms: u16) -> bool {
        self.put_float32(self.outputs.failing().into());
        self.outgoing.put16(u16::from_le_bytes(*b"fs"));
        true
    }

    #[inline(never)]
    fn put_float32(&mut self, number: u16) {
        let [high, low] = float16::to_float32(number);
        self.outgoing.put16(low);
        self.outgoing.put16(high);
    }

    #[inline(always)]
    pub(super) fn put_log_message(&mut self, _: &impl CanCounters, now_ms: u16) -> bool {
        self.log.take(now_ms, |byte| self.outgoing.put8(byte));
        true
    }

    #[inline(always)]
    pub(super) fn put_targetted(&mut self, _: &impl CanCounters, now_ms: u16) -> bool {
        self.tunnel.take(now_ms, |byte| self.outgoing.put8(byte));
        true
    }

    pub(super) fn put_circuit_status(&mut self, _: &impl CanCounters, _now_ms: u16) -> bool {
        self.outgoing.put16(self.parameters.get(Parameter::Pwr1Id));
        self.outgoing.put16(self.power.voltage());
        self.outgoing.put16(self.power.current());
        self.outgoing.put8(self.power.flags());
        self.power.is_known()
    }

    #[inline(never)]
    pub(super) fn put_hardpoint_status(&mut self, _: &impl CanCounters, _now_ms: u16) -> bool {
        let Some((id, holds)) = self.outputs.next_relay() else { return false };
        self.outgoing.put8(id);
        // The weight of the payload, and its variance, are not measured.
        self.outgoing.put16(float16::NAN);
        self.outgoing.put16(float16::NAN);
        self.outgoing.put16(holds.into());
        true
    }

    #[inline(never)]
    pub(super) fn put_battery_info(&mut self, _: &impl CanCounters, _now_ms: u16) -> bool {
        let Self { battery, power, temperature, parameters, outgoing, .. } = self;
        let (kelvin_64ths, flags) = (temperature.kelvin_64ths(), temperature.flags());
        let heat = temperature.has_sensor().then_some((kelvin_64ths, flags));
        battery.put(power, heat, parameters, |word| outgoing.put16(word));
        outgoing.put8(parameters.get(Parameter::BattId) as u8);
        // No number of the model, and no name.
        outgoing.put16(0);
        outgoing.put16(0);
        power.is_known()
    }

    #[inline(never)]
    pub(super) fn put_rpm(&mut self, _: &impl CanCounters, now_ms: u16) -> bool {
        let Self { shaft, parameters, outgoing, .. } = self;
        outgoing.put8(parameters.get(Parameter::RpmId) as u8);
        shaft.put(parameters.get(Parameter::RpmPulses) as u8, now_ms, |word| outgoing.put16(word));
        true
    }

    #[inline(always)]
    pub(super) fn put_allocation(&mut self, _: &impl CanCounters, now_ms: u16) -> bool {
        self.allocation.request(&self.unique_id, now_ms, |byte| self.outgoing.put8(byte));
        true
    }
}
