//! Transfers: splits payloads into frames, and joins frames to payloads (specification, chapter 4).
//!
//! Each buffer has room for the CRC before the payload, so that a transfer of several frames is the bytes of the buffer from its start on, and a
//! transfer of one frame is the bytes behind the CRC.

use dronecan_wire::Tail;

use crate::can::{self, Frame};
use crate::crc;
use crate::registers::{Register, idle};

/// Bytes of a transfer in a frame, before the tail.
const BYTES_PER_FRAME: u8 = 7;
/// Bytes of the CRC of a transfer of several frames.
pub const CRC_LEN: u16 = 2;

/// A transfer to send.
pub struct Outgoing {
    /// SIDH and SIDL.
    pub sid: [u8; 2],
    pub eid8: u8,
    pub eid0: u8,
    pub transfer_id: u8,
    /// The buffer: room for the CRC, and the payload.
    pub buffer: *mut u8,
    /// Length of the payload, which is not empty.
    pub len: u8,
    /// Seed of the type, for a payload of more than 7 bytes.
    pub seed: u16,
}

/// Sends a transfer. Gives up if a frame does not leave.
///
/// # Safety
///
/// The buffer must have `CRC_LEN + len` bytes, and nobody else may have a reference to it.
#[inline(always)]
pub unsafe fn send(outgoing: Outgoing) {
    let Outgoing { sid: [sidh, sidl], eid8, eid0, transfer_id, buffer, len, seed } = outgoing;
    let mut left = len;
    // SAFETY: the caller guarantees that the CRC and `len` bytes are in the buffer. The loop below reads `left` bytes.
    let mut from = unsafe { buffer.add(CRC_LEN.into()) };
    if len > BYTES_PER_FRAME {
        // SAFETY: as above.
        unsafe {
            let crc = crc::of(seed, from, len.into());
            from = buffer;
            buffer.cast::<[u8; 2]>().write(crc.to_le_bytes());
        }
        left += CRC_LEN as u8;
    }
    let mut tail = Tail::START | transfer_id;
    loop {
        if !can::wait_for_room() {
            return;
        }
        can::begin_frame(sidh, sidl, eid8, eid0);
        let mut n = BYTES_PER_FRAME;
        if left <= n {
            n = left;
            tail |= Tail::END;
        }
        left -= n;
        can::exchange(n + 1);
        loop {
            // SAFETY: as above.
            unsafe {
                can::exchange(*from);
                from = from.add(1);
            }
            n -= 1;
            if n == 0 {
                break;
            }
        }
        can::exchange(tail);
        can::send();
        if left == 0 {
            return;
        }
        tail = tail & !Tail::START ^ Tail::TOGGLE;
    }
}

/// Room in the buffer of received transfers: an answer to file.Read, and the rest of a frame that is too much.
pub const RECEIVED_LEN: usize = CRC_LEN as usize + 2 + 256 + BYTES_PER_FRAME as usize;

/// Toggle bit and transfer ID of the next frame of the transfer that is being received. [`NOTHING`] if a first frame must come.
const NEXT: Register = idle::GPIOR1;
const NOTHING: u8 = 0xFF;

/// The transfer that is being received.
#[repr(C)]
pub struct Incoming {
    /// Behind the last byte in the buffer.
    end: *mut u8,
    pub buffer: [u8; RECEIVED_LEN],
}

impl Incoming {
    /// Adds the data of a frame, which has `len` bytes before its tail. Returns true if the transfer is complete.
    #[inline(never)]
    pub fn take(&mut self, frame: &Frame, mut len: u8, tail: u8, seed: u16) -> bool {
        let begin = self.buffer.as_mut_ptr();
        let is_single = tail >= Tail::START | Tail::END;
        let mut end = self.end;
        let mut next = NEXT.read();
        if tail & Tail::START != 0 {
            next = tail & Tail::TRANSFER_ID;
            end = begin;
            if is_single {
                end = end.wrapping_add(CRC_LEN.into());
            }
        }
        // A frame has at most 7 bytes before its tail.
        let last = begin.wrapping_add(RECEIVED_LEN - BYTES_PER_FRAME as usize);
        if tail & (Tail::TOGGLE | Tail::TRANSFER_ID) != next || end > last {
            return false;
        }
        let mut from = frame.data.as_ptr();
        while len != 0 {
            // SAFETY: the frame has so many bytes, and the buffer room for them.
            unsafe {
                end.write_volatile(*from);
                (end, from) = (end.add(1), from.add(1));
            }
            len -= 1;
        }
        self.end = end;
        NEXT.write(next ^ Tail::TOGGLE);
        if tail & Tail::END == 0 {
            return false;
        }
        NEXT.write(NOTHING);
        if is_single {
            return true;
        }
        // A transfer of several frames has more than 7 bytes.
        // SAFETY: the payload is in the buffer.
        let crc = unsafe { crc::of(seed, begin.add(CRC_LEN.into()), self.len()) };
        crc == u16::from_le_bytes([self.buffer[0], self.buffer[1]])
    }

    /// Length of the payload of a complete transfer.
    #[inline(always)]
    pub fn len(&self) -> u16 {
        (self.end.addr() as u16).wrapping_sub(self.buffer.as_ptr().addr() as u16 + CRC_LEN)
    }
}
