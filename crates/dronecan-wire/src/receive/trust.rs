//! Which transfer gives up its lane when another sender's transfer begins and no lane is free.
//!
//! A node may begin transfers and never complete them, or begin each just before a commander's. Its
//! transfers may neither keep the complete transfers of another sender out for long nor break many
//! of them. No frame shows whether its transfer will be complete, so the receiver remembers of each
//! sender whether its last one was. A sender whose last transfer of several frames was complete is
//! *trusted*, from that transfer to its next first frame that gets a lane. A transfer of a trusted
//! sender keeps the trust; the sender itself is trusted again when it completes one.
//!
//! A transfer keeps its lane for [`HOLD_MS`] after each of its frames. Within this time:
//!
//! * A trusted sender gets the lane of one that was not trusted at once. So a sender that begins
//!   transfers only does not keep a trusted one out at all.
//! * Of two trusted senders the first keeps its lane for [`KEEP_MS`] after its first frame, unless
//!   it is the sender that completed a transfer last. In that case the newcomer gets the lane, and
//!   the first is trusted again. So two senders whose transfers begin together take turns. And a
//!   sender that keeps another out must complete a transfer before it can do so again: then it is
//!   the one that completed a transfer last.
//! * Of senders that are not trusted, one in [`CHANCE`] first frames gets the lane. Otherwise a
//!   sender that begins a transfer every few milliseconds could keep a sender out that is not
//!   trusted yet, or has lost a frame, for ever.
//!
//! A search over all that one attacker can do (`tests/search.rs`) finds that it breaks at most
//! every other list of a commander that sends at 50 Hz and is trusted at first. Two attackers that
//! alternate, or one beside a third node that completes lists between its own, still keep a
//! commander out of a single lane. So does one attacker while the commander is not trusted.

use super::Transfer;

/// A transfer keeps its lane for this time after each frame, in milliseconds. The clock may
/// advance just after the frame, so the time is at least 3 ms and at most 4 ms. The next frame of
/// a transfer comes within 2.6 ms at 125 kbit/s if one frame of higher priority goes first, and
/// the frame that wants its lane does, too. (A frame of eight bytes has up to 160 bits.)
pub(super) const HOLD_MS: u16 = 4;

/// A transfer keeps its lane against trusted senders for this time after its first frame, in
/// milliseconds. Less than the period of commands at 50 Hz: one slow transfer keeps out one list.
/// Nine frames need 11.5 ms at 125 kbit/s. The last bit is not counted, so it is at least 17 ms.
const KEEP_MS: u8 = 18;

/// One in this many first frames gets the lane of a sender that is not trusted, if its own sender
/// is not trusted, either. A power of two, and more than the gaps in a list of 15 entries, which
/// has nine frames: the list is completed although another transfer begins in each gap.
const CHANCE: u8 = 16;

/// The trusted senders.
#[derive(Clone, Copy)]
pub(super) struct Trust {
    /// A bit for each node ID.
    pub(super) bits: [u8; 16],
    /// First frames of senders that are not trusted, modulo 256.
    pub(super) contenders: u8,
    /// The sender that completed a transfer of several frames last.
    pub(super) last: u8,
}

impl Trust {
    /// No sender is trusted.
    pub(super) const NONE: Self = Self { bits: [0; 16], contenders: 0, last: 0 };

    /// Sets the bit of a sender to that of `trusted`: 0 or 0xFF. Returns the bit that it had, in
    /// its place.
    #[inline(never)]
    pub(super) fn replace(&mut self, source: u8, trusted: u8) -> u8 {
        let bit = 1 << (source >> 4 & 7);
        let byte = &mut self.bits[usize::from(source & 15)];
        let was = *byte & bit;
        *byte ^= was ^ (trusted & bit);
        was
    }

    /// Trusts a sender that completed a transfer of several frames.
    #[inline(always)]
    pub(super) fn complete(&mut self, source: u8) {
        self.last = source;
        self.replace(source, 0xFF);
    }

    /// True if a transfer keeps its lane, although a transfer of `newcomer` begins. `trusted`: what
    /// [`replace`](Self::replace) returned for `newcomer`, which is trusted again if its transfer
    /// is refused. `inherited`: the stamp of another transfer that `newcomer` is sending, or 0.
    /// `expires_ms`: when a transfer in this lane would expire whose frame came now.
    #[inline(always)]
    pub(super) fn keeps<K, const KEPT: usize>(
        &mut self,
        lane: &Transfer<K, KEPT>,
        newcomer: u8,
        trusted: u8,
        inherited: u8,
        expires_ms: u16,
    ) -> bool {
        if expires_ms.wrapping_sub(lane.expires_ms) >= HOLD_MS {
            return false;
        }
        let stamp = lane.stamp;
        if trusted == 0 {
            if stamp != 0 {
                return true;
            }
            if inherited != 0 {
                return false;
            }
            self.contenders = self.contenders.wrapping_add(1);
            return !self.contenders.is_multiple_of(CHANCE);
        }
        if stamp == 0 || (expires_ms as u8 | 1).wrapping_sub(stamp) >= KEEP_MS {
            return false;
        }
        let keeps = self.last != lane.source;
        self.replace(if keeps { newcomer } else { lane.source }, 0xFF);
        keeps
    }
}
