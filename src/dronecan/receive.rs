//! Received transfers, taken in frame by frame (specification, chapter 4).
//!
//! A transfer is not stored. Of a list of commands only the entry for this node is kept, of anything else the first
//! [`KEPT`] bytes, which is all that a request of interest has; the CRC runs along. What was kept is only used once the
//! last frame has come and the CRC is right.
//!
//! Longer transfers are put together in three lanes, for commands, lights and requests, so that a stream of commands does
//! not disturb a request. A lane belongs to the sender that began, until its transfer ends or is 2 s old: what another
//! begins meanwhile is refused and counted. Transfers of a single frame have a lane to themselves and always come through.
//!
//! A transfer begins with its first frame whatever its transfer ID, as in libcanard: a sender that restarts is heard at
//! once. A frame that comes twice is dropped, by its toggle bit, or begins its transfer again.

use super::crc;
use super::draft::SHORT;
use super::kind::Kind;
use super::wire::{END_OF_TRANSFER, REQUEST_NOT_RESPONSE, SERVICE_NOT_MESSAGE, START_OF_TRANSFER, TOGGLE, TRANSFER_ID};
use crate::can::Frame;
use crate::progmem::Progmem;

/// Bytes of a payload that are kept: those of a GetSet request with an integer and a name of 16 characters.
pub const KEPT: usize = 26;

/// No transfer takes longer (specification, chapter 4), in milliseconds.
const TIMEOUT_MS: u16 = 2000;

/// Why a frame goes no further. From [`Broken`](Self::Broken) on, a transfer is lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Refusal {
    /// It does.
    None,
    /// A message or service that the node has no use for.
    Kind,
    /// From an anonymous sender, or one with this node's own ID.
    Source,
    /// Not a transfer: no tail byte, or a transfer of several frames where one is enough.
    Form,
    /// A request, while there is no room for its reply, or while one of several frames waits and this is another.
    Busy,
    /// The CRC is wrong, or an earlier transfer of the lane did not end.
    Broken,
    /// Another sender's transfer is under way.
    Interleaved,
}

/// A transfer: one that has come whole, or is coming.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer {
    /// There is more to come.
    is_open: bool,
    /// What it is.
    pub kind: Kind,
    /// Who sent it: 1 to 127; 0 if anonymous.
    pub source: u8,
    /// Its priority, 0 to 31; [`DRAFT`](super::draft::DRAFT) if it came in the draft.
    pub priority: u8,
    /// Toggle and transfer ID of the next frame.
    tail: u8,
    /// Whether a list had an entry for this node.
    pub has_entry: bool,
    /// Of a list: 0 if the entry that is coming is for this node.
    other: u8,
    /// Payload bytes so far, or of a list those since its last entry; stays at 255.
    pub len: u8,
    started_ms: u16,
    sum: u16,
    crc: [u8; 2],
    /// What was kept: of a list, its last entry for this node.
    pub bytes: [u8; KEPT],
}

impl Transfer {
    const NONE: Self = Self {
        is_open: false,
        kind: Kind::ARRAY_COMMAND,
        source: 0,
        priority: 0,
        tail: 0,
        has_entry: false,
        other: 0,
        len: 0,
        started_ms: 0,
        sum: 0,
        crc: [0; 2],
        bytes: [0; KEPT],
    };

    /// Whether it has been under way for too long.
    #[inline(always)]
    fn is_old(&self, now_ms: u16) -> bool {
        now_ms.wrapping_sub(self.started_ms) > TIMEOUT_MS
    }

    /// Two of the bytes that were kept, little-endian.
    #[inline(never)]
    pub fn word(&self, at: u8) -> u16 {
        let word = self.bytes.get(usize::from(at)..).and_then(|bytes| bytes.first_chunk());
        word.map_or(0, |word| u16::from_le_bytes(*word))
    }

    /// Its number, 0 to 31.
    pub fn transfer_id(&self) -> u8 {
        self.tail & TRANSFER_ID
    }

    /// Takes payload bytes; of a list, the entries with this ID are to be kept.
    #[inline(never)]
    fn take(&mut self, bytes: &[u8], id: u8) {
        let mut sum = self.sum;
        let mut len = self.len;
        let entry_len = match self.kind {
            Kind::ARRAY_COMMAND => 4,
            Kind::LIGHTS_COMMAND | Kind::DRAFT_COMMAND => 3,
            _ => {
                for &byte in bytes {
                    // Only a transfer of several frames has a CRC.
                    if self.is_open {
                        sum = crc::add(sum, byte);
                    }
                    if let Some(place) = self.bytes.get_mut(usize::from(len)) {
                        *place = byte;
                    }
                    len = len.saturating_add(1);
                }
                self.len = len;
                self.sum = sum;
                return;
            }
        };
        let mut other = self.other;
        let mut has_entry = self.has_entry;
        for &byte in bytes {
            sum = crc::step(sum, byte);
            if len == 0 {
                other = byte ^ id;
            }
            if other == 0 {
                has_entry = true;
                if let Some(place) = self.bytes.get_mut(usize::from(len)) {
                    *place = byte;
                }
            }
            len = len.wrapping_add(1);
            if len == entry_len {
                len = 0;
            }
        }
        self.sum = sum;
        self.other = other;
        self.has_entry = has_entry;
        self.len = len;
    }
}

/// Puts transfers together.
pub struct Receiver {
    lanes: [Transfer; 4],
    /// The lane of the last frame, what it is a frame of, and whether its transfer has come whole.
    lane: u8,
    kind: Kind,
    is_whole: bool,
    /// A request of several frames has come whole, and waits in its lane.
    is_held: bool,
    /// Why the last frame went no further.
    pub refusal: Refusal,
}

/// The lane of transfers of one frame.
const SINGLE: u8 = 3;

/// The lane of requests of several frames.
const REQUESTS: u8 = 2;

impl Receiver {
    /// With nothing under way.
    pub const fn new() -> Self {
        Self {
            lanes: [Transfer::NONE; 4],
            lane: 0,
            kind: Kind::ARRAY_COMMAND,
            is_whole: false,
            is_held: false,
            refusal: Refusal::None,
        }
    }

    /// Takes a frame. If it completes a transfer, that is to be acted on and cleared before the next frame. If it is of no use,
    /// [`refusal`](Self::refusal) says why. Neither, if there is more to come or the frame came twice.
    ///
    /// `me` is this node's ID (0 if it has none), `entry` tells the ID of the entries to keep of a list.
    #[inline(never)]
    pub fn accept(&mut self, frame: &Frame, me: u8, entry: impl Fn(Kind) -> u8, now_ms: u16, flash: impl Progmem) {
        self.refusal = self.sort(frame, me, entry, now_ms, flash);
    }

    /// The transfer that the last frame completed.
    pub fn transfer(&mut self) -> Option<&mut Transfer> {
        if self.is_whole { self.lanes.get_mut(usize::from(self.lane)) } else { None }
    }

    /// Whether there is one, for the price of a byte.
    #[inline(always)]
    pub fn has_transfer(&self) -> bool {
        self.is_whole
    }

    /// What it is, if there is one and it is no request: to be asked after [`accept`](Self::accept) only.
    #[inline(always)]
    pub fn message(&self) -> Option<Kind> {
        (self.is_whole && !self.kind.is_request()).then_some(self.kind)
    }

    /// Whether the last frame was one of a command, and more of it are to come. Not after one that broke the command before it: of those
    /// there may be many, and nothing come of any.
    #[inline(always)]
    pub fn awaits_command(&self) -> bool {
        let [commands, ..] = &self.lanes;
        self.lane == Kind::ARRAY_COMMAND.0 && commands.is_open && self.refusal == Refusal::None
    }

    /// Whether there is a request of several frames that [waits](Self::recall).
    #[inline(always)]
    pub fn holds_request(&self) -> bool {
        self.is_held
    }

    /// Makes the request of several frames that waits the transfer to act on. Whether there is one.
    #[inline(always)]
    pub fn recall(&mut self) -> bool {
        let is_held = core::mem::take(&mut self.is_held);
        if is_held {
            self.lane = REQUESTS;
            self.is_whole = true;
        }
        is_held
    }

    /// More is to be done about the transfer: a request of several frames can wait for that, what is a single frame is to be done
    /// before the next frame.
    #[inline(always)]
    pub fn hold(&mut self) {
        if self.lane == REQUESTS {
            self.is_whole = false;
            self.is_held = true;
        }
    }

    /// It has been acted on.
    #[inline(always)]
    pub fn clear(&mut self) {
        self.is_whole = false;
    }

    /// Puts a frame to its transfer, or says why not.
    #[inline(always)]
    fn sort(&mut self, frame: &Frame, me: u8, entry: impl Fn(Kind) -> u8, now_ms: u16, flash: impl Progmem) -> Refusal {
        self.lane = SINGLE;
        let [priority, high, low, last] = frame.id;
        if priority & Frame::FOREIGN != 0 {
            return Refusal::Kind;
        }
        let source = last & !SERVICE_NOT_MESSAGE;
        let kind = if source == me {
            // Of messages from nobody, what another node without an ID asks an allocator: above the lowest two bits of the
            // type is the discriminator.
            if last != 0 || low & 0b11 != Kind::ALLOCATION.data_type() as u8 {
                return Refusal::Source;
            }
            Kind::ALLOCATION
        } else if source == 0 {
            return Refusal::Source;
        } else if last == source {
            Kind::of_message([high, low], flash)
        } else if low == me | REQUEST_NOT_RESPONSE && me != 0 {
            Kind::of_service(high, flash)
        } else {
            Kind::UNKNOWN
        };
        if kind == Kind::UNKNOWN {
            return Refusal::Kind;
        }
        let kind = if kind == Kind::ARRAY_COMMAND && priority & SHORT != 0 { Kind::DRAFT_COMMAND } else { kind };
        let Some((&tail, payload)) = frame.data().split_last() else { return Refusal::Form };
        let mut lane = kind.0.min(REQUESTS);
        if tail >= START_OF_TRANSFER | END_OF_TRANSFER {
            lane = SINGLE;
        } else if kind >= Kind::GET_NODE_INFO || source == 0 {
            return Refusal::Form;
        }
        if lane == REQUESTS && self.is_held {
            return Refusal::Busy;
        }
        self.lane = lane;
        self.kind = kind;
        let Some(transfer) = self.lanes.get_mut(usize::from(lane)) else { return Refusal::None };

        let mut rest = payload;
        self.refusal = Refusal::None;
        if tail & START_OF_TRANSFER != 0 {
            if tail & TOGGLE != 0 {
                return Refusal::Form;
            }
            if transfer.is_open {
                if !transfer.is_old(now_ms) && transfer.source != source {
                    return Refusal::Interleaved;
                }
                self.refusal = Refusal::Broken;
            }
            transfer.kind = kind;
            transfer.source = source;
            transfer.priority = priority;
            transfer.started_ms = now_ms;
            transfer.has_entry = false;
            transfer.len = 0;
            transfer.tail = tail & TRANSFER_ID;
            transfer.is_open = false;
            if lane != SINGLE {
                let [c0, c1, ref later @ ..] = *payload else {
                    return Refusal::Form;
                };
                transfer.is_open = true;
                transfer.sum = kind.seed(flash);
                transfer.crc = [c0, c1];
                rest = later;
            }
        } else if !transfer.is_open
            || transfer.is_old(now_ms)
            || transfer.source != source
            || transfer.kind != kind
            || (transfer.tail ^ tail) & (TOGGLE | TRANSFER_ID) != 0
        {
            return Refusal::None;
        }
        transfer.tail ^= TOGGLE;
        transfer.take(rest, entry(kind));
        if tail & END_OF_TRANSFER != 0 {
            if transfer.is_open && transfer.sum.to_le_bytes() != transfer.crc {
                self.refusal = Refusal::Broken;
            } else if lane == REQUESTS && transfer.kind != Kind::ALLOCATION {
                self.is_held = true;
            } else {
                self.is_whole = true;
            }
            transfer.is_open = false;
        }
        self.refusal
    }
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
