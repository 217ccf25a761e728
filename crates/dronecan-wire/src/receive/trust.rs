//! Which transfer gives up its lane when another sender's transfer begins and no lane is free.
//!
//! A node may begin transfers and never complete them. Its first frames may neither keep the
//! complete transfers of another sender out nor break them. No frame shows whether its transfer
//! will be complete, so the receiver remembers of each sender whether its last one was. A sender
//! whose last transfer of several frames was complete is *trusted*:
//!
//! * A transfer keeps its lane for [`HOLD_MS`] after each of its frames, except against a trusted
//!   sender if its own sender was not trusted when it began. So of two trusted senders the first
//!   completes its transfer, and a sender that begins transfers only does not keep a trusted one
//!   out at all.
//! * A sender is trusted from its complete transfer to its next first frame that gets a lane. If
//!   that transfer is lost, whatever the reason, the sender is no longer trusted. So it can keep
//!   another out once, for [`HOLD_MS`], for each transfer that it completes.
//! * Of senders that are not trusted, one in [`CHANCE`] first frames gets the lane nevertheless.
//!   Otherwise a sender that begins a transfer every few milliseconds could keep a sender out
//!   that is not trusted yet, or has lost a frame, for ever.

/// A transfer keeps its lane for this time after each frame, in milliseconds. The clock may
/// advance just after the frame, so the time is at least 3 ms and at most 4 ms. The next frame of
/// a transfer comes within 2.6 ms at 125 kbit/s if one frame of higher priority goes first, and
/// the frame that wants its lane does, too. (A frame of eight bytes has up to 160 bits.)
pub(super) const HOLD_MS: u16 = 4;

/// One in this many first frames gets the lane of a sender that is not trusted, if its own sender
/// is not trusted, either. A power of two, and more than the gaps in a list of 15 entries, which
/// has nine frames: the list is completed although another transfer begins in each gap.
const CHANCE: u8 = 16;

/// The trusted senders.
pub(super) struct Trust {
    /// A bit for each node ID.
    bits: [u8; 16],
    /// First frames of senders that are not trusted, modulo 256.
    contenders: u8,
}

impl Trust {
    /// No sender is trusted.
    pub(super) const NONE: Self = Self { bits: [0; 16], contenders: 0 };

    /// Sets the bit of a sender to that of `trusted`: 0 or 0xFF, or what this function returned for
    /// the same sender. Returns the bit that it had, in its place.
    #[inline(never)]
    pub(super) fn replace(&mut self, source: u8, trusted: u8) -> u8 {
        let bit = 1 << (source >> 4 & 7);
        let byte = &mut self.bits[usize::from(source & 15)];
        let was = *byte & bit;
        *byte ^= was ^ (trusted & bit);
        was
    }

    /// True if a transfer keeps its lane, although another sender's begins within [`HOLD_MS`].
    /// 0 for a sender that is not trusted.
    pub(super) fn keeps(&mut self, owner: u8, newcomer: u8) -> bool {
        if owner | newcomer != 0 {
            return owner != 0;
        }
        self.contenders = self.contenders.wrapping_add(1);
        !self.contenders.is_multiple_of(CHANCE)
    }
}
