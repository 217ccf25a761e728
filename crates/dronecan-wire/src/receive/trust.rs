//! Which transfer gets a lane that a transfer of another sender has.
//!
//! A node may begin transfers and never complete them, complete one now and then, or begin each
//! just before a commander's. Its transfers may neither keep the complete transfers of another
//! sender out for long nor break many of them. No frame shows whether its transfer will be
//! complete. So the receiver decides by two things, trust before precedence:
//!
//! * A sender is *trusted* if its last transfer of several frames came to its end. That is: it was
//!   complete, or it had no lane and its last frame came. The trust ends with the sender's next
//!   first frame, and goes to the transfer that this frame begins.
//! * The order of *precedence* of the node IDs is reversed every [`ORDER_MS`], and is another
//!   after twice this time. So each of two IDs precedes the other half of the time.
//!
//! A transfer keeps its lane for [`HOLD_MS`] after each of its frames. Within this time another
//! sender's transfer gets the lane if it is trusted and the first is not, or if both are or neither
//! is and its sender has precedence. What follows:
//!
//! * A sender that only begins transfers does not keep a trusted one out at all.
//! * A sender whose frames all arrive is trusted from the end of its first transfer on, even if
//!   each is refused or displaced. So it is received whenever it precedes all other senders of that
//!   time, whatever these do. `tests/search.rs` tries all that one and two of them can do, and
//!   `tests/order.rs` tells how long it takes until a sender precedes the others.
//! * A frame that the node loses costs the transfer, and if it is the last one the trust in the
//!   next transfer. So it may cost two transfers.

use super::Transfer;

/// A transfer keeps its lane for this time after each frame, in milliseconds. The clock may
/// advance just after the frame, so the time is at least 3 ms and at most 4 ms. The next frame of
/// a transfer comes within 2.6 ms at 125 kbit/s if one frame of higher priority goes first, and
/// the frame that wants its lane does, too. (A frame of eight bytes has up to 160 bits.)
pub(super) const HOLD_MS: u16 = 4;

/// The order of precedence stays for this time, in milliseconds. Then it is reversed, and after
/// twice this time it is another. A power of two. Nine frames need 1.4 ms at 1 Mbit/s and 11.5 ms
/// at 125 kbit/s, so most lists see one order. A list of 50 Hz sees another order than the one
/// before it.
pub(super) const ORDER_MS: u16 = 16;

/// An odd factor with which no sender waits for long until it precedes one or two others, whether
/// it commands at 10, 25, 50, 100 or 400 Hz: see `tests/order.rs`.
const SPREAD: u8 = 27;

/// Stands for trust, above all node IDs.
const TRUSTED: u8 = 0x80;

/// The trusted senders: a bit for each node ID.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Trust(pub(super) [u8; 16]);

impl Trust {
    /// No sender is trusted.
    pub(super) const NONE: Self = Self([0; 16]);

    /// Sets the bit of a sender to that of `trusted`: 0 or 0xFF. Returns the bit that it had, in
    /// its place.
    #[inline(never)]
    fn replace(&mut self, source: u8, trusted: u8) -> u8 {
        let bit = 1 << (source >> 4 & 7);
        let byte = &mut self.0[usize::from(source & 15)];
        let was = *byte & bit;
        *byte ^= was ^ (trusted & bit);
        was
    }

    /// Takes the trust in a sender for the transfer that it begins. Returns 0 if there was none.
    #[inline(always)]
    pub(super) fn begin(&mut self, source: u8) -> u8 {
        self.replace(source, 0)
    }

    /// Trusts a sender whose transfer came to its end.
    #[inline(always)]
    pub(super) fn end(&mut self, source: u8) {
        self.replace(source, 0xFF);
    }
}

/// True if a transfer keeps its lane, although a transfer of `newcomer` begins. `trusted`: 0 if
/// the latter is not trusted. `expires_ms`: when a transfer in this lane would expire whose frame
/// came now.
#[inline(always)]
pub(super) fn keeps<K, const KEPT: usize>(
    lane: &Transfer<K, KEPT>,
    newcomer: u8,
    trusted: u8,
    expires_ms: u16,
) -> bool {
    expires_ms.wrapping_sub(lane.expires_ms) < HOLD_MS
        && claim(lane.source, lane.trusted, expires_ms) >= claim(newcomer, trusted, expires_ms)
}

/// The higher of two claims gets the lane. In each order, each node ID has another place.
#[inline(always)]
pub(super) fn claim(source: u8, trusted: u8, time_ms: u16) -> u8 {
    let (high, low) = ((time_ms >> 8) as u8, time_ms as u8);
    let order = (low / (2 * ORDER_MS as u8)).wrapping_mul(SPREAD) ^ high;
    let order = if low & ORDER_MS as u8 != 0 { !order } else { order };
    let place = (source ^ order) & !TRUSTED;
    if trusted == 0 { place } else { place | TRUSTED }
}
