//! The node's [`Policy`]: which transfer gets a lane that a transfer of another sender has.
//!
//! A node may begin transfers and never complete them, complete one now and then, or begin each
//! just before a commander's. Its transfers may neither keep the complete transfers of another
//! sender out for long nor break many of them. No frame shows whether its transfer will be
//! complete. So the receiver decides by two things, trust before precedence:
//!
//! * A sender is *trusted* from a complete transfer of several frames that has something for this
//!   node, until the node has no use for one of its lists or one is lost: it expires, its CRC is
//!   wrong, or its next frame does not come before the lane has another use. A list without an
//!   entry for this node changes nothing, and a transfer that gets no lane or is displaced is not
//!   lost by its sender. Who lost the trust is trusted again from a transfer that ends in one order
//!   of [`ORDERS`].
//! * The order of *precedence* of the node IDs is another every [`ORDER_MS`]. Each of two IDs
//!   precedes the other half of the time, whatever the senders do.
//!
//! A transfer keeps its lane for [`HOLD_MS`](Policy::HOLD_MS) after each of its frames. Within this
//! time another sender's transfer gets the lane if it is trusted and the first is not, or if both
//! are or neither is and its sender has precedence. What follows:
//!
//! * Senders that command other nodes only, or that never complete a transfer, do not keep a
//!   trusted commander out and break none of its lists.
//! * Of commanders of this node each is received whenever it precedes those that send at the same
//!   time, whatever they do. `tests/search.rs` tries all that one and two of them can do, and
//!   `tests/order.rs` tells how long it takes until a sender precedes the others.
//! * A commander that is not trusted, because it has just begun or the node lost one of its frames,
//!   is received whenever it precedes the others, except in the orders in which senders are trusted
//!   again. For in the other orders a sender that does not complete each of its transfers is not
//!   trusted, either.

use dronecan_wire::Policy;

use crate::tables::bit_rate::HIGHEST_RATE;
use crate::tables::wire;

/// The node's receiver.
pub type Receiver = wire::Receiver<Trust>;

/// The order of precedence stays for this time, in milliseconds. A power of two. Nine frames need
/// 1.4 ms at 1 Mbit/s and 11.5 ms at 125 kbit/s, so most lists see one order. A list of 50 Hz sees
/// another order than the one before it.
const ORDER_MS: u16 = 16;

/// Odd factors with which no sender waits for long until it precedes one or two others, whether it
/// commands at 10, 25, 50, 100 or 400 Hz: see `tests/order.rs`.
const SPREAD: (u8, u8) = (87, 85);

/// Stands for trust, above all node IDs.
const TRUSTED: u8 = 0x80;

/// A sender that lost the trust is trusted again in one of so many orders. A power of two.
const ORDERS: u8 = 4;

/// The trusted senders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trust {
    /// A bit for each node ID.
    trusted: [u8; 16],
    /// A bit for each 16 node IDs: one of them lost the trust.
    lost: u8,
}

impl Trust {
    /// No sender is trusted.
    pub const NONE: Self = Self { trusted: [0; 16], lost: 0 };

    /// True if a sender is trusted.
    fn is_trusted(&self, source: u8) -> bool {
        self.trusted[usize::from(source & 15)] & bit(source) != 0
    }
}

impl Policy for Trust {
    /// 4 ms at 1 Mbit/s, and 8 ms on a board that is no faster than 500 kbit/s: time for 26 frames
    /// of others. A node that keeps its trust by completing some of its lists keeps out more of
    /// another's the longer it is: of 2,500 at 1 Mbit/s 53 with 4 ms, 93 with 8 ms.
    const HOLD_MS: u16 = 4 << (3 - HIGHEST_RATE);

    /// Trust before precedence.
    #[inline(never)]
    fn claim(&self, source: u8, now_ms: u16) -> u8 {
        let place = place(source, now_ms);
        if self.is_trusted(source) { place | TRUSTED } else { place }
    }

    #[inline(never)]
    fn completed(&mut self, source: u8, now_ms: u16) {
        let bit = bit(source);
        if now_ms as u8 & ((ORDERS - 1) * ORDER_MS as u8) == 0 {
            self.lost &= !bit;
        }
        if self.lost & bit == 0 {
            self.trusted[usize::from(source & 15)] |= bit;
        }
    }

    #[inline(never)]
    fn lost(&mut self, source: u8) {
        let trusted = &mut self.trusted[usize::from(source & 15)];
        let bit = *trusted & bit(source);
        *trusted ^= bit;
        self.lost |= bit;
    }
}

/// The place of a sender in the order of precedence, 0 to 127: the highest has precedence.
fn place(source: u8, now_ms: u16) -> u8 {
    let (high, low) = ((now_ms >> 8) as u8, now_ms as u8);
    let order = (low / ORDER_MS as u8).wrapping_mul(SPREAD.0) ^ high.wrapping_mul(SPREAD.1);
    (source ^ order) & !TRUSTED
}

/// The bit of a sender in its byte.
fn bit(source: u8) -> u8 {
    1 << (source >> 4 & 7)
}

// The policy is the same in all presets.
#[cfg(all(test, feature = "standard", feature = "monitor"))]
mod tests;
