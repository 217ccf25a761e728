//! A transfer that is being received, and the bytes that are kept of it.

use super::{Policy, Received, Rejection, Segment};
use crate::bits::Tail;
use crate::crc;
use crate::length::Length;

/// A place for an entry of a list. A transfer has up to eight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// Index of the entry's first byte in [`Transfer::bytes`].
    pub at: u8,
    /// Its bits in [`Transfer::slots`]: one for each user of the entry.
    pub bits: u8,
}

impl Slot {
    /// Bytes of a slot: the longest entry of DroneCAN's lists.
    pub const LEN: u8 = 4;

    /// Slot `n` of eight, with a bit of its own.
    pub const fn new(n: u8) -> Self {
        Self { at: n % 8 * Self::LEN, bits: 1 << (n % 8) }
    }
}

/// Number of bytes before those that [`Received::left_out`] counts.
const HEAD_LEN: u8 = 3;

/// A transfer that is being received, or is complete. Each lane of the
/// [`Receiver`](crate::Receiver) holds one transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer<K, const KEPT: usize, L = u8> {
    /// The transfer is not complete.
    pub(super) is_open: bool,
    /// The type of the transfer.
    pub kind: K,
    /// Node ID of the sender, or 0 if the sender is anonymous.
    pub source: u8,
    /// See [`Segment::priority`].
    pub priority: u8,
    /// Tail of the last frame.
    pub(super) tail: Tail,
    /// Number of payload bytes so far, at most the largest value. In a list: number of bytes of the
    /// current entry.
    pub(super) len: L,
    /// Where the receiver keeps the payload; in a list, the current entry. `NOWHERE` of [`Length`]
    /// for an entry that is not for this node.
    pub(super) kept_at: L,
    /// In a list: the bits of the slots with an entry.
    pub(super) slots: u8,
    /// In a list: number of complete entries. Else: number of bytes that are still to be left out,
    /// see [`Received::left_out`].
    pub(super) entries: u8,
    /// The transfer is lost if its next frame does not come until then.
    pub(super) expires_ms: u16,
    pub(super) sum: u16,
    pub(super) crc: [u8; 2],
    pub(super) bytes: [u8; KEPT],
}

/// How firmly a lane is held, see [`Transfer::hold`]: no transfer is being received.
const FREE: u16 = 0;
/// The next frame is late.
const LATE: u16 = 1;
/// A frame has just come. The claim of the sender is added.
const HELD: u16 = 2;

impl<K: Received, const KEPT: usize, L: Length> Transfer<K, KEPT, L> {
    pub(super) const NONE: Self = Self {
        is_open: false,
        kind: K::UNKNOWN,
        source: 0,
        priority: 0,
        tail: Tail(0),
        len: L::ZERO,
        kept_at: L::ZERO,
        slots: 0,
        entries: 0,
        expires_ms: 0,
        sum: 0,
        crc: [0; 2],
        bytes: [0; KEPT],
    };

    /// For a list: the [bits](Slot::bits) of the slots that have an entry. The entry is in
    /// [`bytes`](Self::bytes), from [`Slot::at`] on.
    pub fn slots(&self) -> u8 {
        self.slots
    }

    /// True while the transfer is not complete.
    pub fn is_open(&self) -> bool {
        self.is_open
    }

    /// The tail of the last frame.
    pub fn tail(&self) -> Tail {
        self.tail
    }

    /// The transfer is lost if its next frame does not come until this time.
    pub fn expires_ms(&self) -> u16 {
        self.expires_ms
    }

    /// The transfer ID, 0 to 31.
    pub fn transfer_id(&self) -> u8 {
        self.tail.transfer_id()
    }

    /// The payload, at most its first `KEPT` bytes. For a list: the last entry for slot 0, or empty
    /// if the list has no entry for this node.
    pub fn payload(&self) -> &[u8] {
        self.bytes.get(..self.len.index()).unwrap_or(&self.bytes)
    }

    /// The payload from this byte on. `None` if it is shorter, or if the receiver did not keep all
    /// of it.
    pub fn payload_from(&self, at: L) -> Option<&[u8]> {
        self.bytes.get(at.index()..self.len.index())
    }

    /// Length of the payload in bytes, at most the largest value of `L`. Counts also the bytes that
    /// were not kept. For a list: as [`payload`](Self::payload).
    #[allow(clippy::len_without_is_empty, reason = "not needed")]
    pub fn len(&self) -> L {
        self.len
    }

    /// True if the payload ended before all bytes came that [`Received::left_out`] counts.
    pub fn is_too_short(&self) -> bool {
        K::TAKES_ENTRIES && self.entries != 0
    }

    /// The buffer that begins with [`payload`](Self::payload). The bytes after the payload are
    /// undefined.
    pub fn bytes(&self) -> &[u8; KEPT] {
        &self.bytes
    }

    /// True for `hold_ms` after a frame of a transfer that is not complete. `expires_ms`: when a
    /// transfer would expire whose frame came now.
    pub(super) fn is_held(&self, hold_ms: u16, expires_ms: u16) -> bool {
        self.is_open && expires_ms.wrapping_sub(self.expires_ms) < hold_ms
    }

    /// True if a transfer of this sender and type has this lane.
    pub(super) fn is_of(&self, source: u8, kind: K) -> bool {
        self.source == source && (!K::LANE_FOR_EACH_TYPE || self.kind == kind)
    }

    /// How firmly the transfer holds its lane: the one with the lowest number is given up first.
    pub(super) fn hold<P: Policy>(&self, policy: &P, expires_ms: u16, now_ms: u16) -> u16 {
        if !self.is_open {
            FREE
        } else if !self.is_held(P::HOLD_MS, expires_ms) {
            LATE
        } else {
            HELD + u16::from(policy.claim(self.source, now_ms))
        }
    }

    /// Begins a transfer with its first frame.
    #[inline(always)]
    pub(super) fn begin(&mut self, segment: &Segment<'_, K>) {
        let &Segment { kind, source, priority, tail, .. } = segment;
        // A single-frame transfer is complete at once.
        self.is_open = !tail.is_end();
        self.kind = kind;
        self.source = source;
        self.priority = priority;
        self.len = L::ZERO;
        self.kept_at = L::ZERO;
        self.slots = 0;
        self.entries = 0;
    }

    /// True if a frame continues the transfer.
    pub(super) fn is_continued_by(&self, segment: &Segment<'_, K>) -> bool {
        self.kind == segment.kind && segment.tail.follows(self.tail)
    }

    /// Adds the payload of a frame.
    #[inline(always)]
    pub(super) fn add(
        &mut self,
        segment: &Segment<'_, K>,
        entry_len: u8,
        slot_of: impl Fn(u8) -> Option<Slot>,
        expires_ms: u16,
    ) {
        let &Segment { kind, tail, payload, .. } = segment;
        self.tail = tail;
        self.expires_ms = expires_ms;
        if K::TAKES_ENTRIES && kind.is_request() {
            self.take_request(payload);
        } else if K::TAKES_ENTRIES {
            self.take_entries(payload, entry_len, slot_of);
        } else {
            self.take(payload, entry_len, slot_of);
        }
    }

    /// True if the CRC of the transfer is right.
    pub(super) fn is_intact(&self) -> bool {
        self.sum.to_le_bytes() == self.crc
    }

    /// Returns the complete transfer. A list must end after an entry, and have as many entries as
    /// its type may have.
    pub(super) fn complete(&mut self, kind: K, entry_len: u8) -> Verdict<'_, K, KEPT, L> {
        if entry_len != 0 {
            if !self.len.is(L::ZERO) || self.entries > kind.most_entries() {
                return Verdict::Rejected(Rejection::Length);
            }
            self.len = if self.slots != 0 { L::from_u8(entry_len) } else { L::ZERO };
        }
        if kind.is_request() { Verdict::Request(self) } else { Verdict::Message(self) }
    }

    /// Adds payload bytes. For a list see [`Received::entry_len`].
    #[inline(always)]
    pub(super) fn take(
        &mut self,
        payload: &[u8],
        entry_len: u8,
        slot_of: impl Fn(u8) -> Option<Slot>,
    ) {
        let (mut len, mut kept_at) = (self.len, self.kept_at);
        for &byte in payload {
            // A single-frame transfer is not open: it has no CRC.
            if self.is_open {
                self.sum = crc::add(self.sum, byte);
            }
            if entry_len != 0 && len.is(L::ZERO) {
                kept_at = L::NOWHERE;
                if let Some(slot) = slot_of(byte) {
                    kept_at = L::from_u8(slot.at);
                    self.slots |= slot.bits;
                }
            }
            if let Some(place) = self.bytes.get_mut(kept_at.plus(len).index()) {
                *place = byte;
            }
            if len.is(L::MAX) {
                continue;
            }
            len = len.plus(L::from_u8(1));
            if len.is(L::from_u8(entry_len)) {
                len = L::ZERO;
                // Of more than 255 entries a wrong CRC would match once in 65,536 times.
                self.entries = self.entries.wrapping_add(1);
            }
        }
        (self.len, self.kept_at) = (len, kept_at);
    }

    /// The same in less time: looks up the slot once for all bytes of an entry.
    pub(super) fn take_entries(
        &mut self,
        payload: &[u8],
        entry_len: u8,
        slot_of: impl Fn(u8) -> Option<Slot>,
    ) {
        if self.is_open {
            self.sum = payload.iter().fold(self.sum, |sum, &byte| crc::step(sum, byte));
        }
        let (mut len, mut kept_at) = (self.len, self.kept_at);
        let mut rest = payload;
        while let &[first, ..] = rest {
            // A payload is at most seven bytes of a frame.
            let mut run = rest.len() as u8;
            if entry_len != 0 {
                if len.is(L::ZERO) {
                    kept_at = L::NOWHERE;
                    if let Some(slot) = slot_of(first) {
                        kept_at = L::from_u8(slot.at);
                        self.slots |= slot.bits;
                    }
                }
                run = run.min(entry_len - len.low());
            }
            let mut at = kept_at.plus(len);
            len = len.plus_at_most(run);
            // Four bytes at once, which are a whole entry of an ArrayCommand: 60 cycles less.
            if run == Slot::LEN
                && let Some((entry, later)) = rest.split_first_chunk::<{ Slot::LEN as usize }>()
            {
                rest = later;
                run = 0;
                let places = self.bytes.get_mut(at.index()..);
                if let Some(place) = places.and_then(|places| places.first_chunk_mut()) {
                    *place = *entry;
                }
            }
            while run != 0 {
                let Some((&byte, later)) = rest.split_first() else { break };
                rest = later;
                if let Some(place) = self.bytes.get_mut(at.index()) {
                    *place = byte;
                }
                at = at.plus(L::from_u8(1));
                run = run.wrapping_sub(1);
            }
            if len.is(L::from_u8(entry_len)) {
                len = L::ZERO;
                self.entries = self.entries.wrapping_add(1);
            }
        }
        (self.len, self.kept_at) = (len, kept_at);
    }

    /// Adds payload bytes of a request, without what [`Received::left_out`] says. A function of its
    /// own, because nothing else that is received has to be as fast as commands.
    #[inline(never)]
    pub(super) fn take_request(&mut self, payload: &[u8]) {
        for &byte in payload {
            if self.is_open {
                self.sum = crc::add(self.sum, byte);
            }
            if self.entries != 0 {
                self.entries -= 1;
                continue;
            }
            if let Some(place) = self.bytes.get_mut(self.len.index()) {
                *place = byte;
            }
            self.len = self.len.plus_at_most(1);
            if self.len.is(L::from_u8(HEAD_LEN)) {
                self.entries = self.kind.left_out(&self.bytes);
            }
        }
    }
}

/// The result of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict<'a, K, const KEPT: usize, L = u8> {
    /// Accepted. The transfer is not complete yet; or ignored, because the frame came twice or its
    /// transfer was lost.
    More,
    /// The frame completed a message; or a response to this node, whose
    /// [transfer ID](Transfer::transfer_id) the program compares with that of its request.
    Message(&'a Transfer<K, KEPT, L>),
    /// The frame completed a request to this node.
    Request(&'a Transfer<K, KEPT, L>),
    /// The frame is dropped, or it caused another transfer to be dropped.
    Rejected(Rejection),
}
