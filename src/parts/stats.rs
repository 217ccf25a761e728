//! The transfer counters of GetTransportStats.

use mcp2515_ordered::{Counter, WORDS};

use crate::node::health::{CanCounters, count};

/// Transfers since the start. All are modulo 65,536.
#[derive(Default)]
pub struct Stats {
    received: u16,
    sent: u16,
    broken: u16,
}

/// Bytes of the counters in a GetTransportStats response: those of the transfers, and three of the
/// controller (DSDL uavcan/protocol/4.GetTransportStats.uavcan).
pub const LEN: u8 = 6 * 6;

impl Stats {
    /// No transfer yet.
    pub const fn new() -> Self {
        Self { received: 0, sent: 0, broken: 0 }
    }

    /// Counts a transfer that was received complete.
    #[inline(always)]
    pub fn count_received(&mut self) {
        count(&mut self.received);
    }

    /// Counts a transfer that was sent complete.
    #[inline(always)]
    pub fn count_sent(&mut self) {
        count(&mut self.sent);
    }

    /// Counts a broken transfer.
    #[inline(always)]
    pub fn count_broken(&mut self) {
        count(&mut self.broken);
    }

    /// Broken transfers.
    pub fn broken(&self) -> u16 {
        self.broken
    }

    /// Puts the lower 16 bits of each counter of GetTransportStats.
    pub fn put_transport(&self, counters: &impl CanCounters, mut put: impl FnMut(u16)) {
        put(self.sent);
        put(self.received);
        put(self.broken);
        for counter in [Counter::TxRequests, Counter::RxReceived, Counter::RxErrors] {
            put(counters.word(counter as u8));
        }
    }

    /// Puts the counters of CanStats.
    pub fn put_can(&self, counters: &impl CanCounters, mut put: impl FnMut(u16)) {
        (0..WORDS).for_each(|n| put(counters.word(n)));
    }
}
