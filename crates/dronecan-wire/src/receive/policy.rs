//! Which of two senders has a lane.

/// Decides which sender has a lane when there are more transfers of several frames than lanes.
///
/// The receiver asks only when a transfer begins and no lane is free. A transfer whose last frame
/// came [`HOLD_MS`](Self::HOLD_MS) ago or earlier then loses its lane. Of the others the receiver
/// chooses the one with the lowest [claim](Self::claim): it loses its lane if the claim of the new
/// transfer is higher, otherwise the new transfer is rejected.
///
/// The receiver also reports what became of the transfers of a sender, so that a policy can
/// remember it. It reports no transfer of a single frame, because such a transfer needs no lane. A
/// transfer that is rejected, or loses its lane to a higher claim, is not reported either: its
/// sender did nothing wrong.
///
/// ```
/// use dronecan_wire::Policy;
///
/// /// The sender with the lower node ID has the lane.
/// struct LowerFirst;
///
/// impl Policy for LowerFirst {
///     fn claim(&self, source: u8, _now_ms: u16) -> u8 {
///         127 - source
///     }
/// }
/// ```
pub trait Policy {
    /// A transfer keeps its lane for this time after each frame, in milliseconds, unless another
    /// sender has a higher claim. The clock may advance just after the frame, so the time is up to
    /// 1 ms shorter. At most [`LIST_FRAME_TIMEOUT_MS`](super::LIST_FRAME_TIMEOUT_MS).
    ///
    /// By default 4 ms: the next frame of a transfer comes within 2.6 ms at 125 kbit/s if one frame
    /// of higher priority goes first, and the frame that wants its lane does, too. (A frame of
    /// eight bytes has up to 160 bits.)
    const HOLD_MS: u16 = 4;

    /// The claim of a sender to a lane. Of two senders the one with the higher claim gets it; with
    /// equal claims, the one that has the lane keeps it.
    fn claim(&self, source: u8, now_ms: u16) -> u8;

    /// A sender completed a transfer that has something for this node. A list without an entry for
    /// this node is not reported.
    #[inline(always)]
    fn completed(&mut self, _source: u8, _now_ms: u16) {}

    /// A transfer of a sender was lost: it expired, its CRC is wrong, its sender began another one
    /// before its end, or its next frame did not come before the lane had another use.
    #[inline(always)]
    fn lost(&mut self, _source: u8) {}

    /// The program has no use for a complete transfer of a sender: see
    /// [`Receiver::refused`](super::Receiver::refused).
    #[inline(always)]
    fn refused(&mut self, source: u8) {
        self.lost(source);
    }
}

/// A simple policy: a sender whose last transfer was complete goes before one whose last transfer
/// was not. Of two equal senders the first keeps the lane while its frames come.
///
/// So a node that begins transfers and never completes them does not keep out a node that completes
/// its own. It can keep out a node that has not completed one yet, or whose last one was lost. A
/// bus with nodes that do so on purpose needs another policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CompleteFirst {
    /// A bit for each node ID: its last transfer was complete.
    complete: [u8; 16],
}

impl CompleteFirst {
    /// No sender has completed a transfer.
    pub const NEW: Self = Self { complete: [0; 16] };

    /// The byte with the bit of a sender, and the bit.
    fn place(source: u8) -> (usize, u8) {
        (usize::from(source >> 3 & 15), 1 << (source & 7))
    }
}

impl Default for CompleteFirst {
    fn default() -> Self {
        Self::NEW
    }
}

impl Policy for CompleteFirst {
    fn claim(&self, source: u8, _now_ms: u16) -> u8 {
        let (at, bit) = Self::place(source);
        u8::from(self.complete[at] & bit != 0)
    }

    fn completed(&mut self, source: u8, _now_ms: u16) {
        let (at, bit) = Self::place(source);
        self.complete[at] |= bit;
    }

    fn lost(&mut self, source: u8) {
        let (at, bit) = Self::place(source);
        self.complete[at] &= !bit;
    }
}
