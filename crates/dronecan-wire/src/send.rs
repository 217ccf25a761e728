//! Splits a payload into the frames of a transfer, a few bytes at a time (specification, chapter
//! 4).
//!
//! The [`Sender`] stores no payload. It asks a [`Payload`] for each byte once, or twice in a
//! multi-frame transfer, because the CRC goes before the payload. So a response of 50 bytes needs
//! no buffer of 50 bytes, but its bytes must not change until the last frame is made.
//! [`Sender::step`] makes at most [`BYTES_PER_STEP`] bytes, so that each step is short.
//!
//! All frames of a transfer have the same [`Id`](crate::Id). The sender does not need it.

use crate::bits::Tail;
use crate::crc;
use crate::length::Length;

/// Payload bytes that one step makes at most.
pub const BYTES_PER_STEP: u8 = 4;

/// Payload bytes in a frame, before the tail byte.
pub const BYTES_PER_FRAME: u8 = 7;

/// The bytes to send. `L` counts them: `u16` for more than 255 bytes.
pub trait Payload<L: Length = u8> {
    /// The number of bytes.
    fn len(&self) -> L;

    /// True if there are no bytes.
    fn is_empty(&self) -> bool {
        self.len().is(L::ZERO)
    }

    /// Returns the byte at index `at`, which is less than [`len`](Self::len).
    fn byte(&self, at: L) -> u8;
}

/// Sends at most the first 255 or 65,535 bytes of the slice.
impl<L: Length> Payload<L> for [u8] {
    fn len(&self) -> L {
        L::of(self)
    }

    fn byte(&self, at: L) -> u8 {
        self.get(at.index()).copied().unwrap_or(0)
    }
}

/// A buffer for the data of one frame.
pub trait Buffer {
    /// The number of bytes in the buffer.
    fn len(&self) -> u8;

    /// True if there are no bytes.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Adds a byte. The sender adds at most eight.
    fn push(&mut self, byte: u8);
}

/// The data of a frame: a ready-made [`Buffer`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Data {
    bytes: [u8; 8],
    len: u8,
}

impl Data {
    /// An empty buffer.
    pub const EMPTY: Self = Self { bytes: [0; 8], len: 0 };

    /// The bytes in the buffer.
    pub fn as_slice(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or(&self.bytes)
    }
}

impl Buffer for Data {
    fn len(&self) -> u8 {
        self.len
    }

    fn push(&mut self, byte: u8) {
        if let Some(place) = self.bytes.get_mut(usize::from(self.len)) {
            *place = byte;
            self.len += 1;
        }
    }
}

/// The next action of the sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// None: there is no transfer.
    Idle,
    /// Compute the CRC.
    Summing,
    /// Make a frame.
    Making,
    /// Wait until the frame is sent.
    Ready,
    /// Wait until the last frame is sent.
    LastReady,
}

/// Makes the frames of one transfer at a time: see the [module](self). `L` counts the bytes of the
/// payload: for more than 255 bytes there is [`LongSender`].
///
/// ```
/// use dronecan_wire::{Data, Id, Sender, types};
///
/// let payload = [3, 0, 0xC0, 1, 0, 0x34, 0xFF, 0x7F];
/// let id = Id::message(24, types::ACTUATOR_STATUS.id, 42);
/// let mut sender = Sender::new();
/// let mut frames = 0;
/// sender.begin(payload.len() as u8, 1, types::ACTUATOR_STATUS.seed);
/// while sender.is_busy() {
///     let mut data = Data::EMPTY;
///     while !sender.is_ready() {
///         sender.step(&payload[..], &mut data);
///     }
///     // Here `id` and `data` go to the CAN controller.
///     frames += 1;
///     sender.sent();
/// }
/// assert_eq!(frames, 2);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sender<L = u8> {
    stage: Stage,
    /// Index of the next byte.
    at: L,
    crc: u16,
    /// Tail of the next frame, without [`Tail::END`].
    tail: u8,
}

impl Sender {
    /// A sender without a transfer.
    pub const fn new() -> Self {
        Self { stage: Stage::Idle, at: 0, crc: 0, tail: 0 }
    }
}

/// A sender of payloads of up to 65,535 bytes.
pub type LongSender = Sender<u16>;

impl LongSender {
    /// A long sender without a transfer.
    pub const fn long() -> Self {
        Self { stage: Stage::Idle, at: 0, crc: 0, tail: 0 }
    }
}

impl<L: Length> Sender<L> {
    /// True from [`begin`](Self::begin) until [`sent`](Self::sent) for the last frame.
    #[inline(always)]
    pub fn is_busy(&self) -> bool {
        self.stage != Stage::Idle
    }

    /// True if a frame is complete and waits for [`sent`](Self::sent).
    pub fn is_ready(&self) -> bool {
        matches!(self.stage, Stage::Ready | Stage::LastReady)
    }

    /// Begins a transfer of `len` bytes of payload. `transfer_id` is 0 to 31. `seed` is the seed of
    /// the type (see [`types`](crate::types)); it has no effect on a single-frame transfer.
    pub fn begin(&mut self, len: L, transfer_id: u8, seed: u16) {
        self.tail = Tail::START | transfer_id;
        self.crc = seed;
        self.at = L::ZERO;
        self.stage =
            if L::from_u8(BYTES_PER_FRAME).is_below(len) { Stage::Summing } else { Stage::Making };
    }

    /// Makes the next bytes, at most to the end of the frame. Call it until
    /// [`is_ready`](Self::is_ready). Pass the same payload in each call, and a buffer that was
    /// empty at the beginning of the frame. Do not call it while a frame is ready or without a
    /// transfer.
    pub fn step(&mut self, payload: &(impl Payload<L> + ?Sized), buffer: &mut impl Buffer) {
        if let Some(tail) = self.fill(payload, buffer) {
            buffer.push(tail.0);
        }
    }

    /// Does the same as [`step`](Self::step), but returns the tail byte of a complete frame and
    /// does not add it. A program for another dialect can put the tail elsewhere.
    pub fn fill(
        &mut self,
        payload: &(impl Payload<L> + ?Sized),
        buffer: &mut impl Buffer,
    ) -> Option<Tail> {
        let mut left = BYTES_PER_STEP;
        while self.at.is_below(payload.len()) && buffer.len() < BYTES_PER_FRAME {
            if left == 0 {
                return None;
            }
            left -= 1;
            let byte = payload.byte(self.at);
            self.at = self.at.plus(L::from_u8(1));
            if self.stage == Stage::Summing {
                self.crc = crc::add(self.crc, byte);
            } else {
                buffer.push(byte);
            }
        }
        if self.stage == Stage::Summing {
            self.at = L::ZERO;
            self.stage = Stage::Making;
            let [low, high] = self.crc.to_le_bytes();
            buffer.push(low);
            buffer.push(high);
            return None;
        }
        let mut tail = self.tail;
        self.stage = Stage::Ready;
        if self.at.is(payload.len()) {
            self.stage = Stage::LastReady;
            tail |= Tail::END;
        }
        Some(Tail(tail))
    }

    /// Notes that the program has sent the frame. Returns true if it was the last one of the
    /// transfer.
    pub fn sent(&mut self) -> bool {
        self.tail = (self.tail & !Tail::START) ^ Tail::TOGGLE;
        let is_last = self.stage == Stage::LastReady;
        self.stage = if is_last { Stage::Idle } else { Stage::Making };
        is_last
    }
}

impl Default for Sender {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use std::vec;
    use std::vec::Vec;

    use super::*;
    use crate::golden::{self, Frame};

    /// Sends the rest of the transfer. Returns the frames, and the number of steps of each.
    fn sent(sender: &mut Sender, id: u32, payload: &[u8]) -> (Vec<Frame>, Vec<usize>) {
        let (mut frames, mut steps) = (vec![], vec![]);
        while sender.is_busy() {
            let mut data = Data { bytes: [0xA5; 8], len: 0 };
            let mut n = 0;
            while !sender.is_ready() {
                sender.step(payload, &mut data);
                n += 1;
                assert!(n < 100);
            }
            frames.push(golden::frame(id, data.as_slice()));
            steps.push(n);
            assert_eq!(sender.sent(), !sender.is_busy());
        }
        (frames, steps)
    }

    #[test]
    fn a_payload_and_a_buffer_without_bytes_are_empty() {
        let is_empty = <[u8] as Payload>::is_empty;
        assert!(is_empty(&[]) && !is_empty(&[0]));
        let empty = |len| Buffer::is_empty(&Data { bytes: [0; 8], len });
        assert!(empty(0) && !empty(1));
    }

    fn transfer(
        id: u32,
        signature: u64,
        transfer_id: u8,
        payload: &[u8],
    ) -> (Vec<Frame>, Vec<usize>) {
        let mut sender = Sender::new();
        sender.begin(<[u8] as Payload>::len(payload), transfer_id, crc::seed(signature));
        sent(&mut sender, id, payload)
    }

    #[test]
    fn payloads_of_every_length_are_split_as_specified() {
        for len in 0..=255 {
            let bytes: Vec<u8> = (0..len).map(|n| (n * 37 + 5) as u8).collect();
            for transfer_id in [0, 1, 31] {
                let (frames, _) =
                    transfer(0x1801_5778, golden::ACTUATOR_STATUS, transfer_id, &bytes);
                let expected =
                    golden::transfer(0x1801_5778, golden::ACTUATOR_STATUS, transfer_id, &bytes);
                assert_eq!(golden::text(&frames), golden::text(&expected), "{len} bytes");
            }
        }
    }

    #[test]
    fn golden_transfers_are_made_byte_for_byte() {
        for (signature, golden) in golden::TRANSFERS {
            let frames = golden::frames(golden);
            let (payload, transfer_id) = golden::payload(*signature, &frames);
            let (made, _) = transfer(frames[0].id, *signature, transfer_id, &payload);
            assert_eq!(golden::text(&made), golden::text(&frames));
        }
    }

    #[test]
    fn a_step_makes_four_bytes_and_the_crc_takes_as_many_steps_more() {
        for len in 0..=255usize {
            let (frames, steps) = transfer(0, 0, 0, &vec![0xA5; len]);
            let is_long = len > 7;
            let mut left = len;
            for (n, &steps) in steps.iter().enumerate() {
                let room = if n == 0 && is_long { 5 } else { 7 };
                let payload = left.min(room);
                left -= payload;
                let summing = if n == 0 && is_long { len.div_ceil(4).max(1) } else { 0 };
                assert_eq!(steps, payload.div_ceil(4).max(1) + summing, "frame {n} of {len} bytes");
            }
            assert_eq!(frames.len(), if is_long { (len + 2).div_ceil(7) } else { 1 });
        }
    }

    #[test]
    fn a_longer_payload_is_cut_to_255_bytes() {
        let bytes = [0xA5; 300];
        let (frames, _) = transfer(0, 0, 0, &bytes);
        assert_eq!(golden::text(&frames), golden::text(&golden::transfer(0, 0, 0, &bytes[..255])));
    }

    #[test]
    fn a_frame_stays_until_it_is_sent() {
        let payload = [1; 8];
        let (mut sender, mut data) = (Sender::new(), Data::EMPTY);
        assert!(!sender.is_busy());
        sender.begin(8, 3, 0);
        while !sender.is_ready() {
            assert!(sender.is_busy());
            sender.step(&payload[..], &mut data);
        }
        assert!(sender.is_ready() && sender.is_busy());
        assert!(!sender.sent(), "there is more");
        assert!(!sender.is_ready() && sender.is_busy());
    }

    #[test]
    fn an_earlier_transfer_does_not_affect_a_later_one() {
        let mut sender = Sender::new();
        sender.begin(25, 31, 0x1234);
        sent(&mut sender, 0x1E0A_7FF8, &[0xFF; 25]);
        sender.begin(1, 6, 0);
        assert_eq!(golden::text(&sent(&mut sender, 0x1E0A_7FF8, &[0x80]).0), "1E0A7FF8 80 C6");
    }
}
