//! The update: reads the file from its server, and writes it to flash.
//!
//! Goals: the program before stays until the file has shown that it is for this board. From then
//! on, the flash holds no valid program until all of the file is written.
//!
//! The first answer has the header of the program. If it is for this board, the first page is
//! erased, and with it the old header. The first page of the file is read again, and written last.
//! Then the chip restarts, and `start.rs` checks the CRC of the whole program. Each answer that
//! cannot be used, and a silent server, also end in a restart: the loader then starts the old
//! program, or waits if there is none.

use dronecan_wire::Tail;
use firmware::handover::{HEADER, HEADER_LENGTH, PATH_LEN, REQUEST_LEN};

use crate::can::NODE_ID;
use crate::node_info::{MODE, SOFTWARE_UPDATE};
use crate::registers::{Register, idle};
use crate::spm::PAGE_LEN;
use crate::transfer::{CRC_LEN, RECEIVED_LEN};
use crate::{image, spm, start};

/// Counts the seconds without an answer. A request of file.Read is to be sent when [`RETRY`]
/// divides it. Sending counts as a second.
const SILENCE: Register = idle::OCR0A;
/// A power of two.
const RETRY: u8 = 4;
/// The update ends after so many seconds without an answer.
const SILENCE_LIMIT: u8 = 40;
/// Transfer ID of the last request of file.Read.
const TRANSFER_ID: Register = idle::GPIOR2;

/// Index of a received payload, behind the CRC.
const PAYLOAD: usize = CRC_LEN as usize;
/// Index of the data in an answer of file.Read, behind the error (int16).
const DATA: usize = PAYLOAD + 2;

/// Length of the payload of an answer before the end of the file.
const ANSWER_LEN: u16 = 2 + 256;

/// A request of file.Read, with room for the CRC before it, and the rest of the request for the
/// update.
#[repr(C)]
pub struct Update {
    /// Length of the program. Set with the first answer.
    length: u16,
    crc: [u8; 2],
    offset: [u8; 5],
    /// What a program hands over: path, length of the path, node ID of the server, CRC (see
    /// [`firmware::handover`]).
    pub request: [u8; REQUEST_LEN],
}

/// True from the request until the restart.
#[inline(always)]
pub fn is_active() -> bool {
    MODE.read() == SOFTWARE_UPDATE
}

/// True if a request of file.Read is to be sent.
#[inline(always)]
pub fn is_read_due() -> bool {
    is_active() && SILENCE.read().is_multiple_of(RETRY)
}

/// Begins to read the file.
#[inline(always)]
pub fn begin() {
    MODE.write(SOFTWARE_UPDATE);
    SILENCE.write(0);
}

/// Gives up if the server is silent for long. Call it once a second.
#[inline(always)]
pub fn tick() {
    if is_active() && count_silence() == SILENCE_LIMIT {
        start::restart_soon();
    }
}

#[inline(always)]
fn count_silence() -> u8 {
    let silence = SILENCE.read() + 1;
    SILENCE.write(silence);
    silence
}

/// Returns the transfer ID for the next request of file.Read.
#[inline(always)]
pub fn next_transfer_id() -> u8 {
    count_silence();
    let transfer_id = (TRANSFER_ID.read() + 1) & Tail::TRANSFER_ID;
    TRANSFER_ID.write(transfer_id);
    transfer_id
}

/// True if the tail has the transfer ID of the last request of file.Read.
#[inline(always)]
pub fn is_answer(tail: u8) -> bool {
    tail & Tail::TRANSFER_ID == TRANSFER_ID.read()
}

impl Update {
    /// Length of the payload of file.Read: offset and path.
    #[inline(always)]
    pub fn len(&self) -> u8 {
        5 + self.request[PATH_LEN]
    }

    /// The node that has the file. While the loader waits for a request of BeginFirmwareUpdate: its
    /// sender.
    #[inline(always)]
    pub fn server(&mut self) -> &mut u8 {
        &mut self.request[PATH_LEN + 1]
    }

    /// The request of file.Read: room for the CRC, and the payload behind it.
    #[inline(always)]
    pub fn buffer(&mut self) -> *mut u8 {
        (&raw mut self.crc).cast()
    }

    /// Takes server and path from a request of BeginFirmwareUpdate. Returns false if the path is
    /// too long.
    #[inline(always)]
    pub fn take_request(&mut self, received: &[u8; RECEIVED_LEN], len: u16) -> bool {
        if len > PATH_LEN as u16 + 1 {
            return false;
        }
        self.request[PATH_LEN] = len as u8 - 1;
        let server = received[PAYLOAD] & NODE_ID;
        // A request without a server means its sender.
        if server != 0 {
            *self.server() = server;
        }
        let mut to = (&raw mut self.request).cast::<u8>();
        let mut from = (&raw const received[PAYLOAD + 1]).cast::<u8>();
        let mut left = PATH_LEN as u8;
        loop {
            // SAFETY: the loop reads and writes the bytes of a path of the greatest length, which
            // both have.
            unsafe {
                to.write_volatile(*from);
                (to, from) = (to.add(1), from.add(1));
            }
            left -= 1;
            if left == 0 {
                return true;
            }
        }
    }

    /// Takes an answer, whose payload has `len` bytes: writes its two pages. Restarts the chip if
    /// that were the last ones, or if the file is not a program for this board.
    #[inline(always)]
    pub fn take_answer(&mut self, received: &[u8; RECEIVED_LEN], len: u16) {
        SILENCE.write(0);
        if !self.write(received, len) {
            start::restart_soon();
        }
    }

    /// Writes the two pages in an answer. Returns true if there is more to read.
    #[inline(always)]
    fn write(&mut self, received: &[u8; RECEIVED_LEN], len: u16) -> bool {
        let data: *const u8 = &raw const received[DATA];
        let word = |at: usize| u16::from_le_bytes([received[at], received[at + 1]]);
        let offset = u16::from_le_bytes([self.offset[0], self.offset[1]]);
        if offset != 0 {
            // SAFETY: the data are in the buffer.
            unsafe { spm::write_page(offset, data) };
        } else {
            let length = word(DATA + HEADER as usize + HEADER_LENGTH);
            let is_for_this_board = word(DATA + HEADER as usize) == image::THIS_BOARD;
            // An answer with an error has no data.
            if len < ANSWER_LEN || !is_for_this_board || !image::is_checkable(length) {
                return false;
            }
            if self.length != 0 {
                // All other pages are written.
                // SAFETY: the data are in the buffer.
                unsafe { spm::write_page(0, data) };
                return false;
            }
            self.length = length;
            spm::erase_page(0);
        }
        // SAFETY: the data are in the buffer.
        unsafe { spm::write_page(offset + PAGE_LEN, data.add(PAGE_LEN.into())) };
        let mut next = offset + 2 * PAGE_LEN;
        if next >= self.length {
            next = 0;
        } else if len < ANSWER_LEN {
            // The file is shorter than its header says.
            return false;
        }
        [self.offset[0], self.offset[1]] = next.to_le_bytes();
        true
    }
}
