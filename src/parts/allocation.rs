//! Requests a node ID from an allocator (specification, chapter 6; DSDL
//! uavcan/protocol/dynamic_node_id/1.Allocation.uavcan).
//!
//! The node sends its unique ID in three anonymous messages. After each, the allocator sends back
//! all the bytes that it has so far, and the node continues with the next part. After any other
//! message of this type the node waits and begins again.

use dronecan_wire::crc;

use crate::tables::wire::Transfer;

/// Minimum time from an Allocation message, received or sent, to the next request, in milliseconds.
const MIN_REQUEST_PERIOD_MS: u16 = 600;

/// Maximum random time in milliseconds, added to the minimum, or alone before a follow-up. The DSDL
/// allows 400.
const RANDOM_MASK: u16 = 0x17F;

/// Bytes of the unique ID in a request.
const MAX_PART_LEN: u8 = 6;

/// The highest ID that a node may have; 126 and 127 are for tools (specification, chapter 6).
const HIGHEST_ID: u8 = 125;

/// The state of the allocation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allocation {
    /// Bytes of the unique ID that the allocator has confirmed.
    confirmed: u8,
    due_ms: u16,
    random: u16,
}

impl Allocation {
    /// The state before the first request.
    pub const fn new() -> Self {
        Self { confirmed: 0, due_ms: 0, random: 0 }
    }

    /// Schedules the first request, after a random time that depends on the unique ID.
    pub fn start(&mut self, unique_id: &[u8; 16], now_ms: u16) {
        for &byte in unique_id {
            self.random = crc::add(self.random, byte);
        }
        self.wait(MIN_REQUEST_PERIOD_MS, now_ms);
    }

    fn wait(&mut self, least_ms: u16, now_ms: u16) {
        self.random = crc::add(self.random, now_ms as u8);
        // This millisecond may be about to end.
        let least_ms = least_ms + 1;
        self.due_ms = now_ms.wrapping_add(least_ms).wrapping_add(self.random & RANDOM_MASK);
    }

    /// True if it is time for a request.
    pub fn is_due(&self, now_ms: u16) -> bool {
        now_ms.wrapping_sub(self.due_ms) < 1 << 15
    }

    /// Puts the payload of a request, byte by byte. Without a response of the allocator, the next
    /// request begins again with the first part.
    pub fn request(&mut self, unique_id: &[u8; 16], now_ms: u16, mut put: impl FnMut(u8)) {
        self.wait(MIN_REQUEST_PERIOD_MS, now_ms);
        let first = core::mem::take(&mut self.confirmed);
        // A node ID of 0 requests any ID; the lowest bit is set for the first part.
        put(u8::from(first == 0));
        for at in first..first + MAX_PART_LEN {
            if let Some(&byte) = unique_id.get(usize::from(at)) {
                put(byte);
            }
        }
    }

    /// Acts on an Allocation message. Returns the node ID that it grants to this node, or 0.
    pub fn act_on_message(&mut self, transfer: &Transfer, unique_id: &[u8; 16], now_ms: u16) -> u8 {
        self.confirmed = 0;
        self.wait(MIN_REQUEST_PERIOD_MS, now_ms);
        let [node_and_flag, ref part @ ..] = *transfer.bytes();
        let part_len = transfer.len().saturating_sub(1);
        // Anonymous messages are requests of other nodes.
        if transfer.source == 0 || part_len == 0 || part_len > 16 {
            return 0;
        }
        for at in 0..part_len {
            if part.get(usize::from(at)) != unique_id.get(usize::from(at)) {
                return 0;
            }
        }
        if part_len == 16 {
            let id = node_and_flag >> 1;
            return if id <= HIGHEST_ID { id } else { 0 };
        }
        self.confirmed = part_len;
        self.wait(0, now_ms);
        0
    }
}

#[cfg(test)]
mod tests;
