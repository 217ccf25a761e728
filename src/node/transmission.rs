//! What the node sends: when, to whom, and the transfer in progress.

use mcp2515_ordered::Frame;

use super::outgoing::{Outgoing, Sending};
use super::publisher::Publisher;
use super::services::Services;
use crate::parts::stats::Stats;

/// What the node sends.
pub struct Transmission {
    /// When messages are sent.
    pub publisher: Publisher,
    /// The requests that wait for their responses.
    pub services: Services,
    /// The transfer in progress.
    pub outgoing: Outgoing,
    /// What the transfer in progress is.
    pub sending: Sending,
}

impl Transmission {
    /// Nothing to send.
    pub const fn new() -> Self {
        Self {
            publisher: Publisher::new(),
            services: Services::new(),
            outgoing: Outgoing::new(),
            sending: Sending::Status,
        }
    }

    /// True if a message or a response is due, or a transfer is in progress.
    #[inline(always)]
    pub fn has_to_send(&self) -> bool {
        self.publisher.is_due() || self.outgoing.is_busy() || !self.services.is_empty()
    }

    /// The frame that is made, or is ready.
    pub fn frame(&self) -> &Frame {
        &self.outgoing.frame
    }

    /// Notes that the controller took the frame.
    #[inline(always)]
    pub fn handed_over(&mut self, now_ms: u16, stats: &mut Stats) {
        if !self.outgoing.handed_over() {
            return;
        }
        stats.count_sent();
        match self.sending {
            Sending::Status => self.publisher.status_handed_over(now_ms),
            Sending::Message => {}
            Sending::Response => {
                if self.services.responded() {
                    self.publisher.publish_status(now_ms);
                }
            }
        }
    }
}
