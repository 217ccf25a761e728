//! Which transfer gets a lane that a transfer of another sender has.
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
//! A transfer keeps its lane for [`HOLD_MS`] after each of its frames. Within this time another
//! sender's transfer gets the lane if it is trusted and the first is not, or if both are or neither
//! is and its sender has precedence. What follows:
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

/// A transfer keeps its lane for this time after each frame, in milliseconds. The clock may
/// advance just after the frame, so the time is at least 3 ms and at most 4 ms. The next frame of
/// a transfer comes within 2.6 ms at 125 kbit/s if one frame of higher priority goes first, and
/// the frame that wants its lane does, too. (A frame of eight bytes has up to 160 bits.)
pub(super) const HOLD_MS: u16 = 4;

/// The order of precedence stays for this time, in milliseconds. A power of two. Nine frames need
/// 1.4 ms at 1 Mbit/s and 11.5 ms at 125 kbit/s, so most lists see one order. A list of 50 Hz sees
/// another order than the one before it.
pub(super) const ORDER_MS: u16 = 16;

/// Odd factors with which no sender waits for long until it precedes one or two others, whether it
/// commands at 10, 25, 50, 100 or 400 Hz: see `tests/order.rs`.
const SPREAD: (u8, u8) = (87, 85);

/// Stands for trust, above all node IDs.
const TRUSTED: u8 = 0x80;

/// A sender that lost the trust is trusted again in one of so many orders. A power of two.
const ORDERS: u8 = 4;

/// The trusted senders.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Trust {
    /// A bit for each node ID.
    trusted: [u8; 16],
    /// A bit for each 16 node IDs: one of them lost the trust.
    lost: u8,
}

impl Trust {
    /// No sender is trusted.
    pub(super) const NONE: Self = Self { trusted: [0; 16], lost: 0 };

    /// All that the state has, for a test that searches states.
    #[cfg(test)]
    pub(super) fn key(&self) -> impl Iterator<Item = u8> + use<> {
        self.trusted.into_iter().chain([self.lost])
    }

    /// A sender completed a transfer of several frames that has something for this node.
    #[inline(never)]
    pub(super) fn completed(&mut self, source: u8, now_ms: u16) {
        let bit = bit(source);
        if now_ms as u8 & ((ORDERS - 1) * ORDER_MS as u8) == 0 {
            self.lost &= !bit;
        }
        if self.lost & bit == 0 {
            self.trusted[usize::from(source & 15)] |= bit;
        }
    }

    /// A transfer of a sender was lost or of no use.
    #[inline(never)]
    pub(super) fn end(&mut self, source: u8) {
        let trusted = &mut self.trusted[usize::from(source & 15)];
        let bit = *trusted & bit(source);
        *trusted ^= bit;
        self.lost |= bit;
    }

    /// True if a sender is trusted.
    #[inline(always)]
    pub(super) fn is_in(&self, source: u8) -> bool {
        self.trusted[usize::from(source & 15)] & bit(source) != 0
    }

    /// True if the sender `first` keeps its lane although a transfer of `second` begins.
    #[inline(always)]
    pub(super) fn is_kept(&self, first: u8, second: u8, now_ms: u16) -> bool {
        self.claim(first, now_ms) >= self.claim(second, now_ms)
    }

    /// The higher of two claims gets the lane.
    #[inline(never)]
    fn claim(&self, source: u8, now_ms: u16) -> u8 {
        let place = place(source, now_ms);
        if self.is_in(source) { place | TRUSTED } else { place }
    }
}

/// The place of a sender in the order of precedence, 0 to 127: the highest has precedence.
#[inline(always)]
pub(super) fn place(source: u8, now_ms: u16) -> u8 {
    let (high, low) = ((now_ms >> 8) as u8, now_ms as u8);
    let order = (low / ORDER_MS as u8).wrapping_mul(SPREAD.0) ^ high.wrapping_mul(SPREAD.1);
    (source ^ order) & !TRUSTED
}

/// The bit of a sender in its byte.
#[inline(always)]
fn bit(source: u8) -> u8 {
    1 << (source >> 4 & 7)
}
