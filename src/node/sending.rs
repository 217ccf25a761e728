//! How a frame leaves: the next message or response, frame by frame, on its way to the controller.

use dronecan_wire::Id;
use mcp2515_ordered::Frame;

use super::Node;
use super::outgoing::Sending;
use super::services::{Pending, Response};
use crate::dialect;
use crate::hardware::CanCounters;
use crate::monitor::Monitor;
use crate::tables::Constants;
use crate::tables::publication::Publication;

/// Priority of Allocation requests, as in the specification's example.
const PRIORITY_LOWER: u8 = 30;

impl Node {
    /// True if [`prepare`](Self::prepare) may have something to do.
    #[inline(always)]
    pub fn has_to_send(&self) -> bool {
        self.transmission.has_to_send()
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
        if self.transmission.outgoing.is_ready() {
            return false;
        }
        if self.transmission.outgoing.is_busy() {
            self.transmission.outgoing.step(&self.identity.unique_id, flash);
            return true;
        }
        // Setting filters takes the controller off the bus and loses the frames that it has not
        // sent. So no new transfer begins before.
        if self.filters.are_pending() {
            return false;
        }
        self.begin_message(counters, now_ms)
            || self.identity.id != 0
                && self.begin_response(&mut Response { now_ms, counters, flash, monitor })
    }

    /// True if a frame is ready.
    pub fn is_ready(&self) -> bool {
        self.transmission.outgoing.is_ready()
    }

    /// The frame that is ready.
    pub fn frame(&self) -> &Frame {
        self.transmission.frame()
    }

    /// Notes that the controller took the frame.
    #[inline(always)]
    pub fn handed_over(&mut self, now_ms: u16) {
        self.transmission.handed_over(now_ms, &mut self.record.stats);
    }

    /// Notes that the controller has sent all its frames.
    pub fn controller_is_empty(&mut self, now_ms: u16) {
        self.transmission.publisher.controller_is_empty(now_ms);
    }

    /// Begins the first message that is due and can be sent. Returns false if there is none.
    #[inline(always)]
    fn begin_message(&mut self, counters: &impl CanCounters, now_ms: u16) -> bool {
        let Some((publication, transfer_id)) = self.transmission.publisher.next(
            now_ms,
            self.identity.id != 0,
            self.sensors.temperature.has_sensor(),
        ) else {
            return false;
        };
        self.transmission.outgoing.clear();
        if !self.put(publication, counters, now_ms) {
            return false;
        }
        self.transmission.sending =
            if publication == Publication::NodeStatus { Sending::Status } else { Sending::Message };
        let id = if publication.is_anonymous() {
            // The discriminator is 14 bits of the CRC, so that requests of different nodes have
            // different identifiers.
            let discriminator = self.transmission.outgoing.sum() >> 1;
            Id::anonymous(PRIORITY_LOWER, publication.data_type(), discriminator).to_bytes()
        } else {
            dialect::message_id(publication.data_type(), self.identity.id)
        };
        self.transmission.outgoing.begin(id, transfer_id, publication.seed());
        true
    }

    /// Begins the response to the oldest request. Returns false if there is none, or if it waits
    /// for a save.
    #[inline(always)]
    pub(super) fn begin_response<C: CanCounters, P: Constants>(
        &mut self,
        context: &mut Response<C, P>,
    ) -> bool {
        if self.transmission.services.is_empty() {
            return false;
        }
        let pending = *self.transmission.services.place(0);
        self.transmission.outgoing.clear();
        if !self.respond(&pending, context) {
            return false;
        }
        self.transmission.sending = Sending::Response;
        let Pending { kind, to, priority, transfer_id, .. } = pending;
        let id = Id::response(priority, kind.data_type(context.flash) as u8, to, self.identity.id);
        self.transmission.outgoing.begin(id.to_bytes(), transfer_id, kind.seed());
        true
    }
}
