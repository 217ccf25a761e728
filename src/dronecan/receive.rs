//! Puts received transfers together, frame by frame (specification, chapter 4).
//!
//! Goals: a transfer is acted on only when its last frame has come and its CRC is right; whoever commands the servo is always
//! received, whatever else is on the bus; nothing is stored that is not used. Of a list only the entry for this node is kept, of a longer
//! request its first [`KEPT`] bytes.
//!
//! Transfers of several frames are put together in lanes: [`LIST_LANES`] for lists, [`REQUEST_LANES`] for requests. A lane belongs to the
//! sender of its transfer.
//!
//! Invariants:
//!
//! * Only the first frame of a transfer opens a lane. It takes the sender's own lane, else a free one, else that of another sender,
//!   whose transfer is lost and counted; but never that of the commander (the node whose command was followed last).
//! * A frame continues a transfer of the same sender and kind whose tail it [follows](Tail::follows). Any other frame that is not a first one
//!   is ignored: it came twice, or its transfer is lost and counted already.
//! * A transfer that has not ended [`TIMEOUT_MS`] after its first frame is given up: [`Receiver::expire`], which is called each millisecond.
//! * Transfers of one frame have a lane to themselves, so they always come through.
//!
//! A transfer begins with its first frame whatever its transfer ID, as in libcanard: a sender that restarts is heard at once.

use super::crc;
use super::kind::Kind;
use super::wire::{Id, Tail};
use crate::can::Frame;

/// Bytes that are kept of a request: those of a GetSet with an integer and a name of 16 characters, and one more, so that a longer name is
/// not taken for a part of it.
pub const KEPT: usize = 27;

/// Lists that can come at the same time, each from another sender.
pub const LIST_LANES: usize = 1;

/// Requests of several frames that can come at the same time.
pub const REQUEST_LANES: usize = 1;

/// No transfer takes longer (specification, chapter 4), in milliseconds.
pub const TIMEOUT_MS: u16 = 2000;

/// A frame as a part of a transfer, in whichever dialect it came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segment<'a> {
    /// What it is a part of.
    pub kind: Kind,
    /// Node ID of the sender; 0 of an anonymous one.
    pub source: u8,
    /// Priority of the frame, 0 to 31; the reply to a request has the same. A dialect may use the bits above.
    pub priority: u8,
    /// Its place in the transfer.
    pub tail: Tail,
    /// What it brings.
    pub payload: &'a [u8],
}

/// What became of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict<'a> {
    /// Its transfer is not complete yet, or the frame came twice.
    More,
    /// It completes a message.
    Message(&'a Transfer),
    /// It completes a request to this node.
    Request(&'a Transfer),
    /// It, or the transfer before it, is dropped.
    Rejected(Rejection),
}

/// Why a frame or a transfer is dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejection {
    /// A message or service that the node has no use for; a standard or a remote frame.
    Unknown,
    /// The sender is anonymous.
    Anonymous,
    /// The sender has this node's ID.
    OwnId,
    /// No tail byte, a first frame with its toggle bit set, or one of several frames where one is enough.
    Malformed,
    /// A list that ends within an entry.
    Length,
    /// A request while there is no room for its reply.
    Busy,
    /// The CRC is wrong, or the sender began another transfer before this one ended.
    Broken,
    /// Another sender's transfer had the lane.
    Interleaved,
}

impl Rejection {
    /// A transfer for this node was lost.
    pub const fn is_loss(self) -> bool {
        matches!(self, Self::Broken | Self::Interleaved)
    }
}

/// Reads a frame of DroneCAN v0 for the node with this ID (0 if it has none).
#[inline(always)]
pub fn segment(frame: &Frame, node: u8) -> Result<Segment<'_>, Rejection> {
    if frame.is_foreign() {
        return Err(Rejection::Unknown);
    }
    let id = Id(frame.id);
    let source = id.source();
    let kind = if source == 0 {
        anonymous(id, node)?
    } else if source == node {
        return Err(Rejection::OwnId);
    } else if !id.is_service() {
        Kind::of_message(id.data_type())
    } else if node != 0 && id.is_request_to(node) {
        Kind::of_request(id.service())
    } else {
        return Err(Rejection::Unknown);
    };
    if kind == Kind::Unknown {
        return Err(Rejection::Unknown);
    }
    let (&tail, payload) = frame.data().split_last().ok_or(Rejection::Malformed)?;
    Ok(Segment { kind, source, priority: id.priority(), tail: Tail(tail), payload })
}

/// What an anonymous frame is. A node without an ID hears other nodes ask an allocator for theirs.
#[inline(always)]
fn anonymous(id: Id, node: u8) -> Result<Kind, Rejection> {
    #[cfg(feature = "allocation")]
    if node == 0 && !id.is_service() && id.anonymous_data_type() == Kind::Allocation.id() {
        return Ok(Kind::Allocation);
    }
    let _ = (id, node);
    Err(Rejection::Anonymous)
}

/// A transfer that comes, or has come whole. Those of several frames are put together in their lane; it is what the lane holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer {
    /// Frames are missing.
    is_open: bool,
    /// What it is.
    pub kind: Kind,
    /// Node ID of the sender; 0 of an anonymous one.
    pub source: u8,
    /// See [`Segment::priority`].
    pub priority: u8,
    /// Tail of the last frame.
    tail: Tail,
    /// Bytes of the payload so far; stays at 255. Of a list, those since its last entry.
    len: u8,
    /// What comes is kept: of a list, the entry that is coming is for this node.
    is_kept: bool,
    /// Of a list: there was an entry for this node.
    has_entry: bool,
    started_ms: u16,
    sum: u16,
    crc: [u8; 2],
    bytes: [u8; KEPT],
}

impl Transfer {
    const NONE: Self = Self {
        is_open: false,
        kind: Kind::Unknown,
        source: 0,
        priority: 0,
        tail: Tail(0),
        len: 0,
        is_kept: false,
        has_entry: false,
        started_ms: 0,
        sum: 0,
        crc: [0; 2],
        bytes: [0; KEPT],
    };

    /// Its number, 0 to 31.
    pub fn transfer_id(&self) -> u8 {
        self.tail.transfer_id()
    }

    /// Its payload, as far as it was kept. Of a list its last entry for this node, empty if there is none.
    #[inline(always)]
    pub fn payload(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or(&self.bytes)
    }

    /// Bytes of the payload, at most 255.
    #[inline(always)]
    #[allow(clippy::len_without_is_empty, reason = "nobody asks")]
    pub fn len(&self) -> u8 {
        self.len
    }

    /// The first bytes of the payload, with whatever follows them.
    #[inline(always)]
    pub fn bytes(&self) -> &[u8; KEPT] {
        &self.bytes
    }

    /// Begins with the first frame.
    #[inline(always)]
    fn begin(&mut self, kind: Kind, source: u8, priority: u8, now_ms: u16) {
        self.is_open = true;
        self.kind = kind;
        self.source = source;
        self.priority = priority;
        self.len = 0;
        self.is_kept = true;
        self.has_entry = false;
        self.started_ms = now_ms;
    }

    /// Takes bytes of the payload. `entry_len` is that of a list, or 0.
    #[inline(always)]
    #[allow(clippy::implicit_saturating_add, reason = "of LLVM 22 it takes 8 instructions a byte instead of 3")]
    fn take(&mut self, payload: &[u8], entry_len: u8, own_id: u8) {
        let (mut len, mut is_kept) = (self.len, self.is_kept);
        for &byte in payload {
            // A transfer of one frame has no CRC.
            if self.is_open {
                self.sum = crc::add(self.sum, byte);
            }
            if entry_len != 0 && len == 0 {
                is_kept = byte == own_id;
                self.has_entry |= is_kept;
            }
            if is_kept && let Some(place) = self.bytes.get_mut(usize::from(len)) {
                *place = byte;
            }
            if len != u8::MAX {
                len += 1;
            }
            if len == entry_len {
                len = 0;
            }
        }
        (self.len, self.is_kept) = (len, is_kept);
    }
}

/// Puts transfers together.
pub struct Receiver {
    lists: [Transfer; LIST_LANES],
    requests: [Transfer; REQUEST_LANES],
    /// That of one frame.
    single: Transfer,
}

impl Receiver {
    /// With nothing under way.
    pub const fn new() -> Self {
        Self { lists: [Transfer::NONE; LIST_LANES], requests: [Transfer::NONE; REQUEST_LANES], single: Transfer::NONE }
    }

    /// A transfer of several frames is under way.
    pub fn is_receiving(&self) -> bool {
        self.lists.iter().chain(&self.requests).any(|lane| lane.is_open)
    }

    /// Gives up a transfer that has taken too long, and says which. To be called at least once a minute, because the clock wraps.
    #[inline(always)]
    pub fn expire(&mut self, now_ms: u16) -> Option<&Transfer> {
        let mut lanes = self.lists.iter_mut().chain(&mut self.requests);
        let lane = lanes.find(|lane| lane.is_open && now_ms.wrapping_sub(lane.started_ms) > TIMEOUT_MS)?;
        lane.is_open = false;
        Some(lane)
    }

    /// Takes a frame. Of a list the entries with `own_id` are for this node; `commander` is the node whose command was followed last, or 0.
    #[inline(always)]
    pub fn accept(&mut self, segment: Segment, own_id: u8, commander: u8, now_ms: u16) -> Verdict<'_> {
        let Segment { kind, source, priority, tail, mut payload } = segment;
        let entry_len = kind.entry_len();
        let lane = if tail.is_single() {
            Some(&mut self.single)
        } else if !kind.is_long() || source == 0 {
            return Verdict::Rejected(Rejection::Malformed);
        } else if entry_len != 0 {
            lane(&mut self.lists, source, tail.is_start(), commander)
        } else {
            lane(&mut self.requests, source, tail.is_start(), 0)
        };
        let mut verdict = Verdict::More;
        let Some(lane) = lane else {
            // What continues no transfer came twice, or its transfer is lost and counted already.
            return if tail.is_start() { Verdict::Rejected(Rejection::Interleaved) } else { verdict };
        };
        if tail.is_start() {
            if tail.toggle() {
                return Verdict::Rejected(Rejection::Malformed);
            }
            if !tail.is_end() {
                let &[low, high, ref rest @ ..] = payload else { return Verdict::Rejected(Rejection::Malformed) };
                lane.crc = [low, high];
                lane.sum = kind.seed();
                payload = rest;
            }
            if lane.is_open {
                let is_own = lane.source == source;
                verdict = Verdict::Rejected(if is_own { Rejection::Broken } else { Rejection::Interleaved });
            }
            lane.begin(kind, source, priority, now_ms);
            // A transfer of one frame has no CRC.
            lane.is_open = !tail.is_end();
        } else if lane.kind != kind || !tail.follows(lane.tail) {
            return verdict;
        }
        lane.tail = tail;
        lane.take(payload, entry_len, own_id);
        if !tail.is_end() {
            return verdict;
        }
        lane.is_open = false;
        if !tail.is_single() && lane.sum.to_le_bytes() != lane.crc {
            return Verdict::Rejected(Rejection::Broken);
        }
        if entry_len != 0 {
            if lane.len != 0 {
                return Verdict::Rejected(Rejection::Length);
            }
            lane.len = if lane.has_entry { entry_len } else { 0 };
        }
        if kind.is_request() { Verdict::Request(lane) } else { Verdict::Message(lane) }
    }
}

/// The lane of this sender's transfer, or one for a transfer that begins: see the module's invariants.
#[inline(always)]
fn lane<const N: usize>(lanes: &mut [Transfer; N], source: u8, is_start: bool, commander: u8) -> Option<&mut Transfer> {
    let mut chosen = None;
    // Rather a free lane than another sender's.
    let mut is_free = false;
    for lane in lanes {
        if lane.is_open && lane.source == source {
            return Some(lane);
        }
        if is_start && !is_free && (!lane.is_open || lane.source != commander) {
            is_free = !lane.is_open;
            chosen = Some(lane);
        }
    }
    chosen
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
