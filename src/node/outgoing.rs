//! Transfers on their way out, made byte by byte.
//!
//! The payload of a long transfer is never stored: each byte is computed when its turn comes, twice, because the CRC goes
//! before the bytes that it is of. What could change in between is kept from the start, in [`Outgoing::kept`]. One step
//! makes a few bytes only, so that the main loop gets round.

use super::{Constants, information};
use crate::can::Frame;
use crate::dronecan::crc;
use crate::dronecan::wire::Tail;

#[cfg(feature = "standard")]
use super::parameters::{self, Descriptions};
#[cfg(feature = "draft")]
use crate::dronecan::draft;
#[cfg(feature = "standard")]
use crate::progmem::Progmem;

/// How the bytes of a payload come about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// They are kept.
    Kept,
    /// Seven kept bytes, the versions, the unique ID, the name (GetNodeInfo).
    NodeInfo,
    /// A parameter (GetSet).
    #[cfg(feature = "standard")]
    Parameter,
    /// One kept byte, then a text (BeginFirmwareUpdate).
    #[cfg(feature = "standard")]
    Text,
    /// Kept numbers of two bytes, each with four zeros after it (GetTransportStats).
    #[cfg(feature = "stats")]
    Numbers48,
}

/// Bytes that can be kept: those of a CanStats, or else of an actuator.Status.
pub const KEPT: usize = if cfg!(feature = "stats") { 25 } else { 8 };

/// A transfer on its way out, frame by frame.
pub struct Outgoing {
    stage: Stage,
    /// Bytes of its payload.
    pub len: u8,
    /// Next byte.
    at: u8,
    crc: u16,
    /// How its bytes come about.
    pub form: Form,
    /// Toggle and transfer ID of the next frame.
    tail: u8,
    /// The frame that is being made, or is ready.
    pub frame: Frame,
    /// The parameter of a [`Form::Parameter`], its value, and where its name is in the flash.
    #[cfg(feature = "standard")]
    pub parameter: (u8, u16, u16),
    /// What is kept of it.
    kept: [u8; KEPT],
    #[cfg(feature = "draft")]
    framing: Framing,
}

/// What differs in a transfer of the draft.
#[cfg(feature = "draft")]
struct Framing {
    is_draft: bool,
    /// Bytes before the payload of each frame: 1 in a reply, whose destination is there.
    lead: u8,
    /// Frames before this one.
    index: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Idle,
    Summing,
    Making,
    Ready,
}

/// Payload bytes that a step makes: one can take 16 us.
const BYTES_AT_ONCE: u8 = 4;

/// Payload bytes of a frame, beside the tail byte.
const PER_FRAME: u8 = 7;

impl Outgoing {
    /// With nothing on its way.
    pub const fn new() -> Self {
        Self {
            frame: Frame::EMPTY,
            form: Form::Kept,
            len: 0,
            kept: [0; KEPT],
            #[cfg(feature = "standard")]
            parameter: (0, 0, 0),
            at: 0,
            tail: 0,
            crc: 0,
            stage: Stage::Idle,
            #[cfg(feature = "draft")]
            framing: Framing { is_draft: false, lead: 0, index: 0 },
        }
    }

    /// Whether a transfer is on its way.
    pub fn is_busy(&self) -> bool {
        self.stage != Stage::Idle
    }

    /// Whether a frame waits to be handed over.
    pub fn is_ready(&self) -> bool {
        self.stage == Stage::Ready
    }

    /// Whether it is one of the draft.
    #[cfg(feature = "draft")]
    pub fn is_draft(&self) -> bool {
        self.framing.is_draft
    }

    /// Forgets what was kept. Unless it is said otherwise, the payload is what is kept from here on, and a message.
    #[inline(never)]
    pub fn clear(&mut self, is_draft: bool) {
        #[cfg(feature = "draft")]
        {
            self.framing = Framing { is_draft, lead: 0, index: 0 };
        }
        let _ = is_draft;
        self.form = Form::Kept;
        self.len = 0;
    }

    /// To whom a reply of the draft goes.
    #[cfg(feature = "draft")]
    #[inline(always)]
    pub fn reply_to(&mut self, to: u8) {
        self.framing.lead = 1;
        self.frame.data[0] = to;
    }

    /// Keeps another byte of the payload.
    #[inline(never)]
    pub fn put8(&mut self, byte: u8) {
        if let Some(place) = self.kept.get_mut(usize::from(self.len)) {
            *place = byte;
            self.len += 1;
        }
    }

    /// Keeps two more, little-endian.
    #[inline(never)]
    pub fn put16(&mut self, word: u16) {
        let [low, high] = word.to_le_bytes();
        self.put8(low);
        self.put8(high);
    }

    /// The CRC of what is kept, without a signature.
    #[cfg(feature = "allocation")]
    pub fn sum(&self) -> u16 {
        (0..self.len).fold(0xFFFF, |sum, at| crc::add(sum, self.kept(at)))
    }

    /// Begins a transfer with this identifier, transfer ID and, where it needs several frames, CRC seed.
    #[inline(never)]
    pub fn begin(&mut self, id: [u8; 4], transfer_id: u8, seed: u16) {
        self.frame.id = id;
        self.tail = Tail::START | transfer_id;
        self.crc = seed;
        self.at = self.first();
        self.frame.len = self.lead();
        self.stage = if self.len > PER_FRAME { Stage::Summing } else { Stage::Making };
    }

    /// Makes the next bytes of a transfer on its way, to the end of a frame at most. Not while a frame is ready.
    #[inline(never)]
    pub fn step(&mut self, unique_id: &[u8; 16], flash: impl Constants) {
        let mut left = BYTES_AT_ONCE;
        while self.at < self.len && self.frame.len < PER_FRAME + self.lead() {
            if left == 0 {
                return;
            }
            left -= 1;
            let byte = self.byte(unique_id, flash);
            self.at += 1;
            if self.stage == Stage::Summing {
                self.crc = crc::add(self.crc, byte);
            } else {
                self.frame.push(byte);
            }
        }
        if self.stage == Stage::Summing {
            self.at = self.first();
            self.stage = Stage::Making;
            let [low, high] = self.crc.to_le_bytes();
            self.frame.push(low);
            self.frame.push(high);
            return;
        }
        self.stage = Stage::Ready;
        let end = if self.at == self.len { Tail::END } else { 0 };
        #[cfg(feature = "draft")]
        if self.framing.is_draft {
            let last = if end != 0 { draft::LAST_FRAME } else { 0 };
            // No transfer of the node has 16 frames, so the index is all here.
            let index = self.framing.index << draft::INDEX_SHIFT;
            self.frame.id[3] = index | self.tail & draft::TRANSFER_ID | last;
            self.framing.index += 1;
            return;
        }
        self.frame.push(self.tail | end);
    }

    /// Bytes before the payload of each frame.
    #[inline(always)]
    fn lead(&self) -> u8 {
        #[cfg(feature = "draft")]
        return self.framing.lead;
        #[cfg(not(feature = "draft"))]
        return 0;
    }

    /// The first byte. The status in a GetNodeInfo of the draft is a byte shorter, so its first is left out.
    #[inline(always)]
    fn first(&self) -> u8 {
        #[cfg(feature = "draft")]
        return u8::from(self.framing.is_draft && self.form == Form::NodeInfo);
        #[cfg(not(feature = "draft"))]
        return 0;
    }

    /// The frame was handed over; whether it was the last one.
    pub fn handed_over(&mut self) -> bool {
        self.tail = (self.tail & !Tail::START) ^ Tail::TOGGLE;
        self.frame.len = self.lead();
        let is_last = self.at == self.len;
        self.stage = if is_last { Stage::Idle } else { Stage::Making };
        is_last
    }

    #[inline(never)]
    fn kept(&self, at: u8) -> u8 {
        self.kept.get(usize::from(at)).copied().unwrap_or(0)
    }

    #[inline(never)]
    fn byte(&self, unique_id: &[u8; 16], flash: impl Constants) -> u8 {
        let at = self.at;
        match self.form {
            Form::Kept => self.kept(at),
            Form::NodeInfo => {
                const STATUS_LEN: u8 = 7;
                const ID_AT: u8 = STATUS_LEN + information::VERSIONS_LEN;
                if at < STATUS_LEN {
                    return self.kept(at);
                }
                let mut skipped = STATUS_LEN;
                if at >= ID_AT {
                    if let Some(&byte) = unique_id.get(usize::from(at - ID_AT)) {
                        return byte;
                    }
                    skipped += 16;
                }
                flash.information(at - skipped)
            }
            #[cfg(feature = "standard")]
            Form::Parameter => {
                let (index, value, name_at) = self.parameter;
                match at.checked_sub(parameters::NUMBERS_LEN) {
                    Some(n) => Progmem::<Descriptions>::byte(flash, name_at + u16::from(n)),
                    None => parameters::response_byte(at, value, index, flash),
                }
            }
            #[cfg(feature = "standard")]
            Form::Text if at == 0 => self.kept(0),
            #[cfg(feature = "standard")]
            Form::Text => flash.information(information::NO_UPDATE_AT - 1 + at),
            #[cfg(feature = "stats")]
            Form::Numbers48 => {
                let (number, at) = (at / 6, at % 6);
                if at < 2 { self.kept(number * 2 + at) } else { 0 }
            }
        }
    }
}

impl Default for Outgoing {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
