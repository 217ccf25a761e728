//! The update: reads the file from its server, and writes it to flash.
//!
//! Goals: the program before stays until the file has shown that it is for this board. From then on, the flash holds no valid program until all of the
//! file is written.
//!
//! The first answer has the header of the program. If it is for this board, the first page is erased, and with it the old header. The first page of
//! the file waits in RAM, and is written last. Then the chip restarts, and `start.rs` checks the CRC of the whole program. Each answer that cannot be
//! used, and a silent server, also end in a restart: the loader then starts the old program, or waits if there is none.

use dronecan_wire::Tail;
use node::handover::{HEADER, HEADER_LENGTH, PATH_LEN, REQUEST_LEN};

use crate::can::NODE_ID;
use crate::node_info::{MODE, SOFTWARE_UPDATE};
use crate::registers::{Register, idle};
use crate::spm::PAGE_LEN;
use crate::transfer::{CRC_LEN, Incoming};
use crate::{image, spm, start};

/// Counts the seconds without an answer. A request of file.Read is to be sent when [`RETRY`] divides it. Sending counts as a second.
const SILENCE: Register = idle::OCR0A;
/// A power of two.
const RETRY: u8 = 4;
/// The update ends after so many seconds without an answer.
const SILENCE_LIMIT: u8 = 40;
/// Transfer ID of the last request of file.Read.
const TRANSFER_ID: Register = idle::GPIOR2;

/// Index of the data in an answer of file.Read, behind the CRC and the error (int16).
const DATA: usize = CRC_LEN as usize + 2;

/// An update: a request of file.Read, with room for the CRC before it, and what else belongs to an update.
#[repr(C)]
pub struct Update {
    crc: [u8; 2],
    offset: [u8; 5],
    /// What a program hands over: see [`node::handover`].
    pub request: [u8; REQUEST_LEN],
    /// Length of the program. Set with the first answer.
    length: u16,
    first_page: [u8; PAGE_LEN as usize],
}

/// True from the request until the restart.
#[inline(always)]
pub fn is_active() -> bool {
    MODE.read() == SOFTWARE_UPDATE
}

/// True if a request of file.Read is to be sent.
#[inline(always)]
pub fn is_read_due() -> bool {
    is_active() && SILENCE.read() % RETRY == 0
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

    /// The node that has the file. While the loader waits for a request of BeginFirmwareUpdate: its sender.
    #[inline(always)]
    pub fn server(&mut self) -> &mut u8 {
        &mut self.request[PATH_LEN + 1]
    }

    /// The request of file.Read: room for the CRC, and the payload behind it.
    #[inline(always)]
    pub fn buffer(&mut self) -> *mut u8 {
        (&raw mut *self).cast()
    }

    /// Takes server and path from a request of BeginFirmwareUpdate. Returns false if the path is too long.
    #[inline(always)]
    pub fn take_request(&mut self, incoming: &Incoming) -> bool {
        let path_len = incoming.len() - 1;
        if path_len > PATH_LEN as u16 {
            return false;
        }
        self.request[PATH_LEN] = path_len as u8;
        let server = incoming.buffer[CRC_LEN as usize] & NODE_ID;
        // A request without a server means its sender.
        if server != 0 {
            *self.server() = server;
        }
        // SAFETY: both are in their buffers.
        unsafe { copy((&raw mut self.request).cast(), (&raw const incoming.buffer[CRC_LEN as usize + 1]).cast(), PATH_LEN as u8) };
        true
    }

    /// Takes an answer: writes the whole pages in it. Restarts the chip if that was the last one, or if the file is not a program for this board.
    #[inline(always)]
    pub fn take_answer(&mut self, incoming: &Incoming) {
        SILENCE.write(0);
        if !self.write(incoming) {
            start::restart_soon();
        }
    }

    /// Writes the whole pages in an answer. Returns true if there is more to read.
    #[inline(always)]
    fn write(&mut self, incoming: &Incoming) -> bool {
        let len = incoming.len();
        if len < 2 {
            return false;
        }
        let mut left = len - 2;
        let mut data: *const u8 = &raw const incoming.buffer[DATA];
        let word = |at: usize| u16::from_le_bytes([incoming.buffer[at], incoming.buffer[at + 1]]);
        let before = u16::from_le_bytes([self.offset[0], self.offset[1]]);
        let mut offset = before;
        if offset == 0 {
            let length = word(DATA + HEADER as usize + HEADER_LENGTH);
            let is_for_this_board = word(DATA + HEADER as usize) == image::THIS_BOARD;
            // An answer with an error has no data.
            if left < PAGE_LEN || !is_for_this_board || !image::is_checkable(length) {
                return false;
            }
            self.length = length;
            spm::erase_page(0);
            // SAFETY: both are in their buffers.
            unsafe { copy((&raw mut self.first_page).cast(), data, PAGE_LEN as u8) };
        }
        // The last page may be shorter in the file. What is written behind it does not matter.
        loop {
            let rest = self.length - offset;
            if left < PAGE_LEN && left < rest {
                break;
            }
            if offset != 0 {
                // SAFETY: the data begin in the middle of the buffer or before.
                unsafe { spm::write_page(offset, data) };
            }
            offset += PAGE_LEN;
            if rest <= PAGE_LEN {
                // SAFETY: the pointer is to a page.
                unsafe { spm::write_page(0, (&raw const self.first_page).cast()) };
                return false;
            }
            left -= PAGE_LEN;
            data = data.wrapping_add(PAGE_LEN.into());
        }
        [self.offset[0], self.offset[1]] = offset.to_le_bytes();
        // Without a whole page, the file is shorter than its header says.
        offset != before
    }
}

/// Copies bytes.
///
/// # Safety
///
/// The bytes must be readable and writable.
#[inline(never)]
unsafe fn copy(mut to: *mut u8, mut from: *const u8, mut len: u8) {
    loop {
        // SAFETY: the caller guarantees it.
        unsafe {
            to.write_volatile(*from);
            (to, from) = (to.add(1), from.add(1));
        }
        len -= 1;
        if len == 0 {
            return;
        }
    }
}
