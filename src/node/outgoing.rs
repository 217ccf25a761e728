//! Outgoing transfers: the payloads that a [`Sender`] splits into frames.
//!
//! The payload of a long transfer is never stored: the sender asks for each byte twice. Values that
//! could change in between are kept from the start, in [`Payload::kept`].

use dronecan_wire::{Buffer, Sender};

use mcp2515_ordered::Frame;

use crate::dialect;
use crate::parts::{stats, update};
use crate::tables::parameters::Response;
use crate::tables::publication::LONGEST;
use crate::tables::{Constants, information};
use dronecan_wire::crc;

/// The transfer that the outgoing frames belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sending {
    /// The node's status.
    Status,
    /// Another message.
    Message,
    /// The response to the oldest request.
    Response,
}

/// The source of a payload's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// All bytes are kept.
    Kept,
    /// Seven kept bytes, the versions, the unique ID, the name (GetNodeInfo). With updates over the
    /// bus, an eighth kept byte is added to the major hardware version.
    NodeInfo,
    /// A parameter (GetSet).
    Parameter,
    /// One kept byte, then a text (BeginFirmwareUpdate).
    Text,
}

/// The largest number of kept bytes: the longest message, a NodeStatus, or the counters of
/// GetTransportStats.
pub const KEPT: usize = {
    let longest = if LONGEST > 8 { LONGEST } else { 8 };
    if longest > stats::LEN { longest } else { stats::LEN }
};

/// An outgoing transfer, frame by frame.
pub struct Outgoing {
    sender: Sender,
    /// The payload of the transfer.
    pub payload: Payload,
    /// The frame that is being made, or is ready.
    pub frame: Frame,
}

/// The payload of a transfer.
pub struct Payload {
    /// Length in bytes.
    pub len: u8,
    /// The source of the bytes.
    pub form: Form,
    /// The parameter of a [`Form::Parameter`].
    pub parameter: Response,
    /// The place of the text of a [`Form::Text`] in the information in flash.
    pub text_at: u8,
    /// The kept bytes.
    kept: [u8; KEPT],
}

/// A payload, and the sources of the bytes that are not kept.
struct Source<'a, P> {
    payload: &'a Payload,
    unique_id: &'a [u8; 16],
    flash: P,
}

impl<P: Constants> dronecan_wire::Payload for Source<'_, P> {
    #[inline(always)]
    fn len(&self) -> u8 {
        self.payload.len
    }

    #[inline(always)]
    fn byte(&self, at: u8) -> u8 {
        self.payload.byte(at, self.unique_id, self.flash)
    }
}

/// The data of a frame.
struct Data<'a>(&'a mut Frame);

impl Buffer for Data<'_> {
    #[inline(always)]
    fn len(&self) -> u8 {
        self.0.len
    }

    #[inline(always)]
    fn push(&mut self, byte: u8) {
        self.0.push(byte);
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
                parameter: Response::NONE,
                text_at: 0,
                kept: [0; KEPT],
            },
            frame: Frame::EMPTY,
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

    /// Begins a new payload without any bytes: all bytes are kept. Set another [`Form`] afterwards.
    #[inline(never)]
    pub fn clear(&mut self) {
        self.payload.form = Form::Kept;
        self.payload.len = 0;
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

    /// Keeps so many more bytes with the value 0.
    #[inline(never)]
    pub fn put_zeros(&mut self, count: u8) {
        for _ in 0..count {
            self.put8(0);
        }
    }

    /// Keeps two more bytes, little-endian.
    #[inline(never)]
    pub fn put16(&mut self, word: u16) {
        let [low, high] = word.to_le_bytes();
        self.put8(low);
        self.put8(high);
    }

    /// Keeps a number of six more bytes, little-endian: a count of 32 bits in two words.
    #[inline(never)]
    pub fn put48(&mut self, low: u16, high: u16) {
        self.put16(low);
        self.put16(high);
        self.put16(0);
    }

    /// The CRC of the kept bytes, without a signature.
    pub fn sum(&self) -> u16 {
        (0..self.payload.len).fold(0xFFFF, |sum, at| crc::add(sum, self.payload.kept(at)))
    }

    /// Begins a transfer with this identifier and transfer ID. `seed` is the initial CRC of a
    /// transfer of several frames.
    #[inline(never)]
    pub fn begin(&mut self, id: [u8; 4], transfer_id: u8, seed: u16) {
        self.frame.id = id;
        self.frame.len = 0;
        self.sender.begin(self.payload.len, transfer_id, seed);
    }

    /// Makes the next bytes of the transfer, up to the end of the frame. Do not call while a frame
    /// is ready.
    #[inline(never)]
    pub fn step(&mut self, unique_id: &[u8; 16], flash: impl Constants) {
        let source = Source { payload: &self.payload, unique_id, flash };
        if let Some(tail) = self.sender.fill(&source, &mut Data(&mut self.frame)) {
            dialect::finish(&mut self.frame, tail);
        }
    }

    /// Notes that the frame was handed over. Returns true if it was the last of the transfer.
    #[inline(always)]
    pub fn handed_over(&mut self) -> bool {
        self.frame.len = 0;
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
                let at = at - skipped;
                let byte = flash.information(information::index_of(at));
                if update::IS_THERE && at == information::HARDWARE_AT {
                    return byte | self.kept(STATUS_LEN);
                }
                byte
            }
            Form::Parameter => self.parameter.byte(at, flash),
            Form::Text if !update::HAS_TEXTS || at == 0 => self.kept(0),
            Form::Text => flash.information(self.text_at - 1 + at),
        }
    }
}

#[cfg(all(test, not(feature = "draft")))]
mod tests;
