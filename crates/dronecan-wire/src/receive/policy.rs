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
/// [`Receiver::with_policy`](super::Receiver::with_policy) takes a policy of your own. With this
/// one nobody keeps the autopilot out:
///
/// ```
/// use dronecan_wire::{Id, Policy, Receiver, Segment, Verdict};
/// # use dronecan_wire::{Received, types};
/// # #[derive(Clone, Copy, Debug, PartialEq, Eq)]
/// # enum Kind { Unknown, ArrayCommand }
/// # impl Received for Kind {
/// #     const UNKNOWN: Self = Self::Unknown;
/// #     fn of_message(id: u16) -> Self {
/// #         if id == types::ARRAY_COMMAND.id { Self::ArrayCommand } else { Self::Unknown }
/// #     }
/// #     fn of_request(_service: u8) -> Self { Self::Unknown }
/// #     fn is_request(self) -> bool { false }
/// #     fn is_multi_frame(self) -> bool { true }
/// #     fn entry_len(self) -> u8 { 4 }
/// #     fn seed(self) -> u16 { types::ARRAY_COMMAND.seed }
/// # }
///
/// struct AutopilotFirst {
///     autopilot: u8,
/// }
///
/// impl Policy for AutopilotFirst {
///     fn claim(&self, source: u8, _now_ms: u16) -> u8 {
///         u8::from(source == self.autopilot)
///     }
/// }
///
/// // One lane for lists. Node 20 begins an ArrayCommand, and the autopilot sends a whole one.
/// let mut receiver = Receiver::<Kind, 1, 1, 8, _>::with_policy(AutopilotFirst { autopilot: 10 });
/// let (node, actuator, now_ms) = (42, 2, 0);
/// let first = [0x12, 0xF3, 0x01, 0x00, 0x00, 0x38, 0x02, 0x88];
/// let last = [0x00, 0x00, 0xBC, 0x03, 0x04, 0xDC, 0x65, 0x68];
/// for (source, data) in [(20, first), (10, first), (10, last)] {
///     let id = Id::message(16, types::ARRAY_COMMAND.id, source);
///     let segment = Segment::read(id, &data, node).unwrap();
///     if let Verdict::Message(command) = receiver.accept(segment, actuator, now_ms) {
///         assert_eq!(command.source, 10);
/// #       return;
///     }
/// }
/// # panic!("no command was received");
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
    fn completed(&mut self, _source: u8, _now_ms: u16) {}

    /// A transfer of a sender was lost: it expired, its CRC is wrong, its sender began another one
    /// before its end, or its next frame did not come before the lane had another use.
    fn lost(&mut self, _source: u8) {}

    /// The program has no use for a complete transfer of a sender: see
    /// [`Receiver::refused`](super::Receiver::refused).
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
