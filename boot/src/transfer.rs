//! Transfers: splits payloads into frames, and joins frames to payloads (specification, chapter 4).
//!
//! Each buffer has room for the CRC before the payload, so that a transfer of several frames is the
//! bytes of the buffer from its start on, and a transfer of one frame is the bytes behind the CRC.

use dronecan_wire::Tail;

use crate::layout::{BYTES_PER_FRAME, CRC_LEN, RECEIVED_LEN};
use crate::registers::{Register, idle};
use crate::variables::{RECEIVED_END, received, received_word};
use crate::{can, crc};

/// A transfer to send.
pub struct Outgoing {
    pub sidh: u8,
    pub sidl: u8,
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
    let Outgoing { sidh, sidl, eid8, eid0, transfer_id, buffer, len, seed } = outgoing;
    let mut left = len;
    // SAFETY: the caller guarantees that the CRC and `len` bytes are in the buffer. The loop below
    // reads `left` bytes.
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

/// Toggle bit and transfer ID of the next frame of the transfer that is being received. [`NOTHING`]
/// if a first frame must come.
const NEXT: Register = idle::GPIOR1;
const NOTHING: u8 = 0xFF;

/// Adds the data of the received frame, which has `len` bytes before its tail, to the transfer.
/// Returns the length of the payload if it is complete. An empty one is no transfer.
#[inline(always)]
pub fn take(len: u8, tail: u8, seed: u16) -> Option<u16> {
    let is_single = tail >= Tail::START | Tail::END;
    let mut next = NEXT.read();
    let mut at = RECEIVED_END.read();
    if tail & Tail::START != 0 {
        next = tail & Tail::TRANSFER_ID;
        at = if is_single { CRC_LEN } else { 0 };
    }
    if tail & (Tail::TOGGLE | Tail::TRANSFER_ID) != next
        || at > RECEIVED_LEN as u16 - u16::from(BYTES_PER_FRAME)
    {
        return None;
    }
    NEXT.write(next ^ Tail::TOGGLE);
    let mut left = len;
    let mut from = can::data();
    let mut to = received().wrapping_add(at.into());
    while left != 0 {
        // SAFETY: a frame has at most 7 bytes before its tail, and the buffer has room for them
        // behind those of the frames before.
        unsafe {
            to.write_volatile(*from);
            (to, from) = (to.add(1), from.add(1));
        }
        left -= 1;
    }
    at += u16::from(len);
    RECEIVED_END.write(at);
    if tail & Tail::END == 0 {
        return None;
    }
    NEXT.write(NOTHING);
    // A transfer of two frames can be shorter than its CRC.
    if at <= CRC_LEN {
        return None;
    }
    let payload_len = at - CRC_LEN;
    if !is_single {
        // SAFETY: the payload is in the buffer.
        let crc = unsafe { crc::of(seed, received().add(CRC_LEN.into()), payload_len) };
        if crc != received_word(0) {
            return None;
        }
    }
    Some(payload_len)
}

#[cfg(test)]
mod tests;
