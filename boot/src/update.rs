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
use firmware::handover::{HEADER, HEADER_LENGTH, PATH_LEN};

use crate::can::NODE_ID_BITS;
use crate::layout::CRC_LEN;
use crate::node_info::{MODE, SOFTWARE_UPDATE};
use crate::registers::{Register, idle};
use crate::spm::PAGE_LEN;
use crate::variables::*;
use crate::{image, spm, start};

/// Counts the seconds without an answer. A request of file.Read is to be sent when [`RETRY`]
/// divides it. Sending counts as a second.
const SILENCE: Register = idle::OCR0A;
/// A power of two.
const RETRY: u8 = 4;
/// The update ends at this count: after 29 to 30 seconds without an answer, and ten requests.
const SILENCE_LIMIT: u8 = 40;

/// Index of a received payload, behind the CRC.
const PAYLOAD: usize = CRC_LEN as usize;
/// Index of the data in an answer of file.Read, behind the error (int16).
const DATA: usize = PAYLOAD + 2;

/// Length of the payload of an answer before the end of the file.
const ANSWER_LEN: u16 = 2 + 256;

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
        start::restart();
    }
}

#[inline(always)]
fn count_silence() -> u8 {
    let silence = SILENCE.read() + 1;
    SILENCE.write(silence);
    silence
}

/// The transfer ID of a request of file.Read: each request for the same part of the file has the
/// same, so that a late answer to an earlier one counts.
#[inline(always)]
fn transfer_id() -> u8 {
    OFFSET_HIGH.read() & Tail::TRANSFER_ID
}

/// Returns the transfer ID for a request of file.Read, which is to be sent now.
#[inline(always)]
pub fn begin_request() -> u8 {
    count_silence();
    transfer_id()
}

/// True if the tail has the transfer ID of the requests for this part of the file.
#[inline(always)]
pub fn is_answer(tail: u8) -> bool {
    tail & Tail::TRANSFER_ID == transfer_id()
}

/// Length of the payload of file.Read: offset and path.
#[inline(always)]
pub fn request_len() -> u8 {
    5 + REQUEST_PATH_LEN.read()
}

/// Takes server and path from the received request of BeginFirmwareUpdate. Returns false if the
/// path is too long.
#[inline(always)]
pub fn take_request(len: u16) -> bool {
    if len > PATH_LEN as u16 + 1 {
        return false;
    }
    REQUEST_PATH_LEN.write(len as u8 - 1);
    let server = received_byte(PAYLOAD) & NODE_ID_BITS;
    // A request without a server means its sender.
    if server != 0 {
        SERVER.write(server);
    }
    let mut to = request();
    let mut from = received().wrapping_add(PAYLOAD + 1);
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

/// Takes the received answer, whose payload has `len` bytes: writes its two pages. Restarts the
/// chip if that were the last ones, or if the file is not a program for this board.
#[inline(always)]
pub fn take_answer(len: u16) {
    SILENCE.write(0);
    if !write(len) {
        start::restart();
    }
}

/// Writes the two pages in an answer. Returns true if there is more to read.
#[inline(always)]
fn write(len: u16) -> bool {
    let data: *const u8 = received().wrapping_add(DATA);
    let offset = OFFSET.read();
    if offset != 0 {
        // SAFETY: the data are in the buffer.
        unsafe { spm::write_page(offset, data) };
    } else {
        let length = received_word(DATA + HEADER as usize + HEADER_LENGTH);
        let is_for_this_board = received_word(DATA + HEADER as usize) == image::THIS_BOARD;
        // An answer with an error has no data.
        if len < ANSWER_LEN || !is_for_this_board || !image::is_checkable(length) {
            return false;
        }
        if PROGRAM_LEN.read() != 0 {
            // All other pages are written.
            // SAFETY: the data are in the buffer.
            unsafe { spm::write_page(0, data) };
            return false;
        }
        PROGRAM_LEN.write(length);
        spm::erase_first_page();
    }
    // SAFETY: the data are in the buffer.
    unsafe { spm::write_page(offset + PAGE_LEN, data.add(PAGE_LEN.into())) };
    let mut next = offset + 2 * PAGE_LEN;
    if next >= PROGRAM_LEN.read() {
        next = 0;
    } else if len < ANSWER_LEN {
        // The file is shorter than its header says.
        return false;
    }
    OFFSET.write(next);
    true
}
