//! Transfers on their way out, made byte by byte.
//!
//! The payload of a long transfer is never stored: each byte is computed when its turn comes, twice, because the CRC goes
//! before the bytes that it is of. What could change in between is kept from the start, in [`Outgoing::kept`]. One step
//! makes a few bytes only, so that the main loop gets round.

use super::{information, parameters};
use crate::can::Frame;
use crate::can::mcp2515::Counted;
use crate::dronecan::crc;
use crate::dronecan::draft;
use crate::dronecan::wire::{END_OF_TRANSFER, START_OF_TRANSFER, TOGGLE};
use crate::progmem::{INFORMATION, Progmem};

/// How the bytes of a payload come about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Form {
    /// They are kept.
    Kept,
    /// Kept numbers of two bytes, each with four zeros after it (GetTransportStats).
    Numbers48,
    /// A parameter (GetSet).
    Parameter,
    /// Seven kept bytes, the versions, the unique ID, the name (GetNodeInfo).
    NodeInfo,
    /// One kept byte, then a text (BeginFirmwareUpdate).
    Text,
}

/// Bytes that can be kept: those of a CanStats.
pub const KEPT: usize = 25;

/// A transfer on its way out, frame by frame.
#[repr(C)]
pub struct Outgoing {
    // What is used most first: see `Node`.
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
    /// It is one of the draft.
    pub is_draft: bool,
    /// Bytes before the payload, of each frame: 1 in a reply of the draft, whose destination is there.
    lead: u8,
    /// Of the draft: frames before this one, times 16.
    index: u8,
    /// Identifier of its frames, and the frame that is being made, or is ready.
    pub frame: Frame,
    /// The parameter of a [`Form::Parameter`], its value, and where its name is in the flash.
    pub parameter: u8,
    /// See [`parameter`](Self::parameter).
    pub value: u16,
    /// See [`parameter`](Self::parameter).
    pub name_at: u16,
    /// What is kept of it.
    pub kept: [u8; KEPT],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Idle,
    Summing,
    Making,
    Ready,
}

/// Payload bytes that a step makes: one can take 16 us.
const BYTES_AT_ONCE: u8 = 2;

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
            parameter: 0,
            value: 0,
            name_at: 0,
            at: 0,
            tail: 0,
            crc: 0,
            stage: Stage::Idle,
            is_draft: false,
            lead: 0,
            index: 0,
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

    /// Forgets what was kept. Unless it is said otherwise, the payload is what is kept from here on, and a message.
    #[inline(never)]
    pub fn clear(&mut self, is_draft: bool) {
        self.is_draft = is_draft;
        self.lead = 0;
        self.form = Form::Kept;
        self.len = 0;
    }

    /// To whom a reply of the draft goes.
    #[inline(always)]
    pub fn reply_to(&mut self, to: u8) {
        self.lead = 1;
        self.frame.data[0] = to;
    }

    /// The identifier of a transfer of the draft.
    #[inline(never)]
    pub fn address(&mut self, [b0, b1]: [u8; 2], source: u8) {
        self.frame.id = [b0, b1 | source >> 6, source << 2, 0];
    }

    /// Keeps another byte of the payload.
    #[inline(never)]
    pub fn put8(&mut self, byte: u8) {
        if let Some(place) = self.kept.get_mut(usize::from(self.len)) {
            *place = byte;
        }
        self.len = self.len.wrapping_add(1);
    }

    /// Keeps two more, little-endian.
    #[inline(never)]
    pub fn put16(&mut self, word: u16) {
        let [low, high] = word.to_le_bytes();
        self.put8(low);
        self.put8(high);
    }

    /// Keeps those of some words after the first byte, quicker than one by one.
    #[inline(always)]
    pub fn put_words(&mut self, words: &impl Counted) {
        let [_, places @ ..] = &mut self.kept;
        words.copy(places.as_chunks_mut().0);
        self.len = KEPT as u8;
    }

    /// The CRC of what is kept, without a signature.
    #[inline(never)]
    pub fn sum(&self) -> u16 {
        let mut sum = 0xFFFF;
        let mut at = 0;
        while at < self.len {
            sum = crc::add(sum, self.kept(at));
            at = at.wrapping_add(1);
        }
        sum
    }

    /// Begins a transfer of what is kept, with this transfer ID and, where it needs several frames, CRC seed.
    pub fn begin(&mut self, transfer_id: u8, seed: u16) {
        self.tail = START_OF_TRANSFER | transfer_id;
        self.crc = seed;
        self.at = self.first();
        self.index = 0;
        self.frame.len = self.lead;
        self.stage = if self.len > PER_FRAME { Stage::Summing } else { Stage::Making };
    }

    /// Makes the next bytes of a transfer on its way, to the end of a frame at most. Not while a frame is ready.
    #[inline(never)]
    pub fn step(&mut self, unique_id: &[u8; 16], flash: impl Progmem) {
        let mut left = BYTES_AT_ONCE;
        while self.at < self.len && self.frame.len < PER_FRAME + self.lead {
            if left == 0 {
                return;
            }
            left = left.wrapping_sub(1);
            let byte = self.byte(unique_id, flash);
            self.at = self.at.wrapping_add(1);
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
        let end = if self.at == self.len { END_OF_TRANSFER } else { 0 };
        if !self.is_draft {
            return self.frame.push(self.tail | end);
        }
        // No transfer of the node has 16 frames, so the index is all here.
        self.frame.id[3] = self.index | self.tail & draft::TRANSFER_ID | end >> 3;
        self.index = self.index.wrapping_add(1 << 4);
    }

    /// The first byte. The status in a GetNodeInfo of the draft is a byte shorter, so its first is left out.
    fn first(&self) -> u8 {
        u8::from(self.is_draft && self.form == Form::NodeInfo)
    }

    /// The frame was handed over; whether it was the last one.
    pub fn handed_over(&mut self) -> bool {
        self.tail = (self.tail & !START_OF_TRANSFER) ^ TOGGLE;
        self.frame.len = self.lead;
        let is_last = self.at == self.len;
        self.stage = if is_last { Stage::Idle } else { Stage::Making };
        is_last
    }

    #[inline(never)]
    fn kept(&self, at: u8) -> u8 {
        self.kept.get(usize::from(at)).copied().unwrap_or(0)
    }

    #[inline(never)]
    fn byte(&self, unique_id: &[u8; 16], flash: impl Progmem) -> u8 {
        let mut at = self.at;
        match self.form {
            Form::Kept => self.kept(at),
            Form::Numbers48 => {
                // By six, as far as there are bytes.
                let number = (u16::from(at).wrapping_mul(43) >> 8) as u8;
                at = at.wrapping_sub(number.wrapping_mul(6));
                if at < 2 { self.kept(number.wrapping_mul(2).wrapping_add(at)) } else { 0 }
            }
            Form::Parameter if at >= parameters::NUMBERS_LEN => {
                flash.byte(self.name_at.wrapping_add(u16::from(at.wrapping_sub(parameters::NUMBERS_LEN))))
            }
            Form::Parameter => parameters::response_byte(at, self.value, self.parameter, flash),
            Form::NodeInfo => {
                const STATUS_LEN: u8 = 7;
                const ID_AT: u8 = STATUS_LEN + information::VERSIONS_LEN;
                if at < STATUS_LEN {
                    return self.kept(at);
                }
                let mut skipped = STATUS_LEN;
                if at >= ID_AT {
                    if let Some(&byte) = unique_id.get(usize::from(at.wrapping_sub(ID_AT))) {
                        return byte;
                    }
                    skipped = skipped.wrapping_add(16);
                }
                flash.byte(INFORMATION.wrapping_add(u16::from(at.wrapping_sub(skipped))))
            }
            Form::Text if at == 0 => self.kept(0),
            Form::Text => {
                flash.byte(INFORMATION.wrapping_add(u16::from((information::NO_UPDATE_AT - 1).wrapping_add(at))))
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
