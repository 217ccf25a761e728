//! Takes a program through the serial port, by the protocol of Arduino's bootloaders: STK500
//! version 1 (Atmel application note AVR061), as far as avrdude needs it. docs/update.md has what
//! it lacks.
//!
//! A session begins with the reset that avrdude causes through DTR, and ends by the watchdog: a
//! second after the last byte, or soon after the command to leave. All waits here end so, too.

use crate::registers::*;
use crate::spm::PAGE_LEN;
use crate::start::{Timeout, set_watchdog};
use crate::transfer::RECEIVED_LEN;
use crate::{image, spm};

/// Commands.
mod command {
    pub const GET_PARAMETER: u8 = b'A';
    pub const SET_DEVICE: u8 = b'B';
    pub const SET_DEVICE_EXT: u8 = b'E';
    pub const LEAVE_PROGMODE: u8 = b'Q';
    pub const LOAD_ADDRESS: u8 = b'U';
    pub const UNIVERSAL: u8 = b'V';
    pub const PROG_PAGE: u8 = b'd';
    pub const READ_PAGE: u8 = b't';
    pub const READ_SIGN: u8 = b'u';
}

/// Type of the memory in PROG_PAGE and READ_PAGE: the flash. The loader has no other, and reads the
/// flash instead.
const FLASH: u8 = b'F';

/// End of a command.
const CRC_EOP: u8 = b' ';
/// Begin and end of an answer.
const INSYNC: u8 = 0x14;
const OK: u8 = 0x10;

/// UBRR0L for twice the speed, rounded.
const UBRR: u8 = {
    let baud = match u32::from_str_radix(env!("UPLOAD_BAUD"), 10) {
        Ok(baud) => baud,
        Err(_) => panic!("upload_baud is a number"),
    };
    ((16_000_000 / 4 / baud - 1) / 2) as u8
};

/// Takes commands until the watchdog resets the chip.
#[inline(always)]
pub fn serve(buffer: &mut [u8; RECEIVED_LEN]) -> ! {
    UBRR0L.write(UBRR);
    UCSR0A.write(U2X0);
    UCSR0B.write(RXEN0 | TXEN0);
    set_watchdog(Timeout::Second);
    let mut address = 0;
    loop {
        let command = receive();
        let parameters = match command {
            command::GET_PARAMETER => 1,
            command::SET_DEVICE => 20,
            command::SET_DEVICE_EXT => 5,
            command::LOAD_ADDRESS => 2,
            command::UNIVERSAL => 4,
            // Length, most significant byte first, and type of the memory.
            command::PROG_PAGE => 3 + PAGE_LEN as u8,
            command::READ_PAGE => 3,
            _ => 0,
        };
        let mut to = (&raw mut *buffer).cast::<u8>();
        let mut left = parameters;
        while left != 0 {
            // SAFETY: the buffer is longer than the longest parameters.
            unsafe {
                to.write_volatile(receive());
                to = to.add(1);
            }
            left -= 1;
        }
        if receive() != CRC_EOP {
            // Out of step: the session ends.
            #[allow(clippy::empty_loop, reason = "the watchdog ends it")]
            loop {}
        }
        send(INSYNC);
        if command == command::LOAD_ADDRESS {
            // The address counts words.
            address = u16::from_le_bytes([buffer[0], buffer[1]]) << 1;
        } else if command == command::PROG_PAGE && buffer[2] == FLASH {
            // SAFETY: the page follows the length and the type.
            unsafe { spm::write_page(address, (&raw const buffer[3]).cast()) };
        } else if command == command::READ_PAGE {
            let mut left = buffer[1];
            loop {
                send(image::read_flash(address) as u8);
                address += 1;
                left -= 1;
                if left == 0 {
                    break;
                }
            }
        } else if command == command::READ_SIGN {
            send(SIGNATURE[0]);
            send(SIGNATURE[1]);
            send(SIGNATURE[2]);
        } else if command == command::GET_PARAMETER || command == command::UNIVERSAL {
            // Of the parameters only the versions are asked for.
            send(VERSION);
        } else if command == command::LEAVE_PROGMODE {
            set_watchdog(Timeout::Soon);
        }
        send(OK);
    }
}

/// A version of the protocol that avrdude accepts.
const VERSION: u8 = 3;

/// Signature bytes of the chip.
const SIGNATURE: [u8; 3] =
    if image::BOOT_SECTION < 0x4000 { [0x1E, 0x94, 0x06] } else { [0x1E, 0x95, 0x0F] };

#[inline(never)]
fn send(byte: u8) {
    while !UCSR0A.has(UDRE0) {}
    UDR0.write(byte);
}

/// Waits for a byte, and gives the watchdog another second then.
#[inline(never)]
fn receive() -> u8 {
    while !UCSR0A.has(RXC0) {}
    // SAFETY: WDR changes no memory.
    unsafe { core::arch::asm!("wdr", options(nomem, nostack, preserves_flags)) };
    UDR0.read()
}
