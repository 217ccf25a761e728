//! The transfer counters of GetTransportStats.

use mcp2515_ordered::{Counter, WORDS};

use crate::node::health::CanCounters;

/// Transfers since the start, modulo 2^32.
#[derive(Default)]
pub struct Stats {
    sent: u32,
    received: u32,
    broken: u32,
}

/// Increments a counter.
#[inline(never)]
fn count(counter: &mut u32) {
    // In halves, as there is seldom a carry: on a full bus every cycle of a frame counts.
    let (low, has_carry) = (*counter as u16).overflowing_add(1);
    *counter = *counter & 0xFFFF_0000 | u32::from(low);
    if has_carry {
        *counter = counter.wrapping_add(1 << 16);
    }
}

/// Bytes of the counters in a GetTransportStats response: those of the transfers, and three of the
/// controller (DSDL uavcan/protocol/4.GetTransportStats.uavcan).
pub const LEN: u8 = 6 * 6;

impl Stats {
    /// No transfer yet.
    pub const fn new() -> Self {
        Self { sent: 0, received: 0, broken: 0 }
    }

    /// Counts a transfer that was received complete.
    pub fn count_received(&mut self) {
        count(&mut self.received);
    }

    /// Counts a transfer that was sent complete.
    pub fn count_sent(&mut self) {
        count(&mut self.sent);
    }

    /// Counts a broken transfer.
    pub fn count_broken(&mut self) {
        count(&mut self.broken);
    }

    /// Broken transfers, modulo 65,536.
    pub fn broken(&self) -> u16 {
        self.broken as u16
    }

    /// Puts the lower 32 bits of each counter of GetTransportStats.
    pub fn put_transport(&self, counters: &impl CanCounters, mut put: impl FnMut(u32)) {
        put(self.sent);
        put(self.received);
        put(self.broken);
        for counter in [Counter::TxRequests, Counter::RxReceived, Counter::RxErrors] {
            let [low, high] = counter.words().map(|n| counters.word(n));
            put(u32::from(high) << 16 | u32::from(low));
        }
    }

    /// Puts the counters of CanStats.
    pub fn put_can(&self, counters: &impl CanCounters, mut put: impl FnMut(u16)) {
        (0..WORDS).for_each(|n| put(counters.word(n)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_counts_of_transfers_have_32_bits() {
        let mut stats = Stats::new();
        (0..70_000).for_each(|_| stats.count_received());
        (0..65_537).for_each(|_| stats.count_sent());
        (0..3).for_each(|_| stats.count_broken());
        let mut put = std::vec::Vec::new();
        stats.put_transport(&mcp2515_ordered::Counters::new(), |number| put.push(number));
        assert_eq!(put, [65_537, 70_000, 3, 0, 0, 0]);
    }
}
