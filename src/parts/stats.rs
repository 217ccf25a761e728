//! The transfer counters of GetTransportStats.

use mcp2515_ordered::{Counter, WORDS};

use crate::hardware::CanCounters;

/// Transfers since the start, modulo 2^32.
#[derive(Default)]
pub struct Stats {
    sent: Count,
    received: Count,
    broken: Count,
}

/// A counter modulo 2^32, in halves, as there is seldom a carry: on a full bus every cycle of a
/// frame counts.
#[derive(Default)]
struct Count {
    low: u16,
    high: u16,
}

impl Count {
    fn count(&mut self) {
        self.low = self.low.wrapping_add(1);
        if self.low == 0 {
            self.high = self.high.wrapping_add(1);
        }
    }
}

/// Bytes of the counters in a GetTransportStats response: those of the transfers, and three of the
/// controller (DSDL uavcan/protocol/4.GetTransportStats.uavcan).
pub const LEN: usize = 6 * 6;

impl Stats {
    /// No transfer yet.
    pub const fn new() -> Self {
        const NONE: Count = Count { low: 0, high: 0 };
        Self { sent: NONE, received: NONE, broken: NONE }
    }

    /// Counts a transfer that was received complete.
    pub fn count_received(&mut self) {
        self.received.count();
    }

    /// Counts a transfer that was sent complete.
    #[inline(never)]
    pub fn count_sent(&mut self) {
        self.sent.count();
    }

    /// Counts a broken transfer.
    #[inline(never)]
    pub fn count_broken(&mut self) {
        self.broken.count();
    }

    /// Broken transfers, modulo 65,536.
    pub fn broken(&self) -> u16 {
        self.broken.low
    }

    /// Puts the words of each counter of GetTransportStats, the low one first.
    pub fn put_transport(&self, counters: &impl CanCounters, mut put: impl FnMut(u16, u16)) {
        for count in [&self.sent, &self.received, &self.broken] {
            put(count.low, count.high);
        }
        for counter in [Counter::TxRequests, Counter::RxReceived, Counter::RxErrors] {
            let [low, high] = counter.words();
            put(counters.word(low), counters.word(high));
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
        stats.put_transport(&mcp2515_ordered::Counters::new(), |low, high| {
            put.push(u32::from(high) << 16 | u32::from(low))
        });
        assert_eq!(put, [65_537, 70_000, 3, 0, 0, 0]);
    }
}
