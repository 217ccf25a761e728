//! Outgoing transfers: the payloads that a [`Sender`] splits into frames.
//!
//! The payload of a long transfer is never stored: the sender asks for each byte twice. Values that
//! could change in between are kept from the start, in [`Payload::kept`].

use dronecan_wire::{Buffer, Sender};

use mcp2515_ordered::Frame;

use super::{Constants, information};

#[cfg(feature = "draft")]
use super::draft;
#[cfg(feature = "standard")]
use super::parameters::{self, Descriptions};
#[cfg(feature = "standard")]
use crate::progmem::Progmem;
#[cfg(feature = "allocation")]
use dronecan_wire::crc;

/// The source of a payload's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// All bytes are kept.
    Kept,
    /// Seven kept bytes, the versions, the unique ID, the name (GetNodeInfo).
    NodeInfo,
    /// A parameter (GetSet).
    #[cfg(feature = "standard")]
    Parameter,
    /// One kept byte, then a text (BeginFirmwareUpdate).
    #[cfg(feature = "standard")]
    Text,
    /// Kept numbers of two bytes, each followed by four zeros (GetTransportStats).
    #[cfg(feature = "stats")]
    Numbers48,
}

/// The largest number of kept bytes: a CanStats or a Targetted, or without them an actuator.Status.
pub const KEPT: usize = if cfg!(any(feature = "stats", feature = "tunnel")) { 25 } else { 8 };

/// An outgoing transfer, frame by frame.
pub struct Outgoing {
    sender: Sender,
    /// The payload of the transfer.
    pub payload: Payload,
    /// The frame that is being made, or is ready.
    pub frame: Frame,
    #[cfg(feature = "draft")]
    framing: Framing,
}

/// The payload of a transfer.
pub struct Payload {
    /// Length in bytes.
    pub len: u8,
    /// The source of the bytes.
    pub form: Form,
    /// The parameter of a [`Form::Parameter`], its value, and the place of its name in the flash.
    #[cfg(feature = "standard")]
    pub parameter: (u8, u16, u16),
    /// The place of the text of a [`Form::Text`] in the information in flash.
    #[cfg(feature = "update")]
    pub text_at: u8,
    /// The kept bytes.
    kept: [u8; KEPT],
}

/// Framing of a transfer of the draft.
#[cfg(feature = "draft")]
struct Framing {
    is_draft: bool,
    /// Bytes before the payload of each frame: 1 in a response, for the destination.
    lead: u8,
    /// Number of frames before this one.
    index: u8,
}

/// A payload, and the sources of the bytes that are not kept.
struct Source<'a, P> {
    payload: &'a Payload,
    /// Bytes left out at the beginning.
    skipped: u8,
    unique_id: &'a [u8; 16],
    flash: P,
}

impl<P: Constants> dronecan_wire::Payload for Source<'_, P> {
    #[inline(always)]
    fn len(&self) -> u8 {
        self.payload.len - self.skipped
    }

    #[inline(always)]
    fn byte(&self, at: u8) -> u8 {
        self.payload.byte(at + self.skipped, self.unique_id, self.flash)
    }
}

/// The data of a frame after the bytes before its payload.
struct Data<'a> {
    frame: &'a mut Frame,
    lead: u8,
}

impl Buffer for Data<'_> {
    #[inline(always)]
    fn len(&self) -> u8 {
        self.frame.len - self.lead
    }

    #[inline(always)]
    fn push(&mut self, byte: u8) {
        self.frame.push(byte);
    }
}

impl Outgoing {
    /// No transfer in progress.
    pub const fn new() -> Self {
        Self {
            sender: Sender::new(),
            payload: Payload {
                len: 0,
                form: Form::Kept,
                #[cfg(feature = "standard")]
                parameter: (0, 0, 0),
                #[cfg(feature = "update")]
                text_at: 0,
                kept: [0; KEPT],
            },
            frame: Frame::EMPTY,
            #[cfg(feature = "draft")]
            framing: Framing { is_draft: false, lead: 0, index: 0 },
        }
    }

    /// True while a transfer is in progress.
    #[inline(always)]
    pub fn is_busy(&self) -> bool {
        self.sender.is_busy()
    }

    /// True if a frame waits to be handed over.
    #[inline(always)]
    pub fn is_ready(&self) -> bool {
        self.sender.is_ready()
    }

    /// True if the transfer is one of the draft.
    #[cfg(feature = "draft")]
    pub fn is_draft(&self) -> bool {
        self.framing.is_draft
    }

    /// Begins a new payload without any bytes: a message whose bytes are kept. Set another [`Form`]
    /// or call `reply_to` afterwards.
    #[inline(never)]
    pub fn clear(&mut self, is_draft: bool) {
        #[cfg(feature = "draft")]
        {
            self.framing = Framing { is_draft, lead: 0, index: 0 };
        }
        let _ = is_draft;
        self.payload.form = Form::Kept;
        self.payload.len = 0;
    }

    /// Sets the destination of a response of the draft.
    #[cfg(feature = "draft")]
    #[inline(always)]
    pub fn reply_to(&mut self, to: u8) {
        self.framing.lead = 1;
        let [destination, ..] = &mut self.frame.data;
        *destination = to;
    }

    /// Keeps another byte of the payload.
    #[inline(never)]
    pub fn put8(&mut self, byte: u8) {
        let payload = &mut self.payload;
        if let Some(place) = payload.kept.get_mut(usize::from(payload.len)) {
            *place = byte;
            payload.len += 1;
        }
    }

    /// Keeps two more bytes, little-endian.
    #[inline(never)]
    pub fn put16(&mut self, word: u16) {
        let [low, high] = word.to_le_bytes();
        self.put8(low);
        self.put8(high);
    }

    /// The CRC of the kept bytes, without a signature.
    #[cfg(feature = "allocation")]
    pub fn sum(&self) -> u16 {
        (0..self.payload.len).fold(0xFFFF, |sum, at| crc::add(sum, self.payload.kept(at)))
    }

    /// Begins a transfer with this identifier and transfer ID. `seed` is the initial CRC of a
    /// transfer of several frames.
    #[inline(never)]
    pub fn begin(&mut self, id: [u8; 4], transfer_id: u8, seed: u16) {
        self.frame.id = id;
        self.frame.len = self.lead();
        self.sender.begin(self.payload.len - self.skipped(), transfer_id, seed);
    }

    /// Makes the next bytes of the transfer, up to the end of the frame. Do not call while a frame
    /// is ready.
    #[inline(never)]
    pub fn step(&mut self, unique_id: &[u8; 16], flash: impl Constants) {
        let source = Source { payload: &self.payload, skipped: self.skipped(), unique_id, flash };
        let lead = self.lead();
        let mut data = Data { frame: &mut self.frame, lead };
        let Some(tail) = self.sender.fill(&source, &mut data) else { return };
        #[cfg(feature = "draft")]
        if self.framing.is_draft {
            draft::set_place(&mut self.frame.id, self.framing.index, tail);
            self.framing.index += 1;
            return;
        }
        self.frame.push(tail.0);
    }

    /// Bytes before the payload of each frame.
    #[inline(always)]
    fn lead(&self) -> u8 {
        #[cfg(feature = "draft")]
        return self.framing.lead;
        #[cfg(not(feature = "draft"))]
        return 0;
    }

    /// Bytes of the payload that are left out. The status in a GetNodeInfo response of the draft is
    /// one byte shorter, so the first byte is left out.
    #[inline(always)]
    fn skipped(&self) -> u8 {
        #[cfg(feature = "draft")]
        return u8::from(self.framing.is_draft && self.payload.form == Form::NodeInfo);
        #[cfg(not(feature = "draft"))]
        return 0;
    }

    /// Notes that the frame was handed over. Returns true if it was the last of the transfer.
    #[inline(always)]
    pub fn handed_over(&mut self) -> bool {
        self.frame.len = self.lead();
        self.sender.sent()
    }
}

impl Payload {
    #[inline(never)]
    fn kept(&self, at: u8) -> u8 {
        self.kept.get(usize::from(at)).copied().unwrap_or(0)
    }

    #[inline(never)]
    fn byte(&self, at: u8, unique_id: &[u8; 16], flash: impl Constants) -> u8 {
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
                flash.information(information::index_of(at - skipped))
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
            Form::Text => {
                #[cfg(feature = "update")]
                let text_at = self.text_at;
                #[cfg(not(feature = "update"))]
                let text_at = information::NO_UPDATE_AT;
                flash.information(text_at - 1 + at)
            }
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
