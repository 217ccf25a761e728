//! Takes a program through the serial port, by the protocol of Arduino's bootloaders: STK500
//! version 1 (Atmel application note AVR061), as far as avrdude needs it. docs/update.md has what
//! it lacks.
//!
//! A session begins with the reset that avrdude causes through DTR, and ends by the watchdog: a
//! second after the last byte, or soon after the command to leave. All waits here end so, too.

use core::arch::asm;

use crate::clock::{Timeout, set_watchdog};
use crate::registers::*;
use crate::spm::PAGE_LEN;
use crate::variables::{OFFSET, received, received_byte, received_word};
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
pub fn serve() -> ! {
    UBRR0L.write(UBRR);
    UCSR0A.write(U2X0);
    UCSR0B.write(RXEN0 | TXEN0);
    set_watchdog(Timeout::Second);
    loop {
        let mut command = receive();
        take_parameters(match command {
            // Of the parameters only the versions are asked for.
            command::GET_PARAMETER => 1,
            command::LOAD_ADDRESS => 2,
            command::READ_PAGE => 3,
            command::UNIVERSAL => 4,
            command::SET_DEVICE_EXT => 5,
            command::SET_DEVICE => 20,
            // Length, most significant byte first, type of the memory, and the page.
            command::PROG_PAGE => 3 + PAGE_LEN as u8,
            _ => 0,
        });
        // Two chains of comparisons are shorter than the branches that the compiler makes of them.
        // SAFETY: the block is empty.
        unsafe { asm!("/* {0} */", inout(reg) command, options(nomem, nostack, preserves_flags)) };
        match command {
            command::GET_PARAMETER | command::UNIVERSAL => send(VERSION),
            // The address counts words.
            command::LOAD_ADDRESS => OFFSET.write(received_word(0) << 1),
            command::PROG_PAGE => {
                if received_byte(2) == FLASH {
                    // SAFETY: the page follows the length and the type.
                    unsafe { spm::write_page(OFFSET.read(), received().add(3)) };
                }
            }
            command::READ_PAGE => {
                let mut address = OFFSET.read();
                let mut left = received_byte(1);
                loop {
                    send(image::read_next(&mut address));
                    left -= 1;
                    if left == 0 {
                        break;
                    }
                }
            }
            command::READ_SIGN => {
                send(SIGNATURE[0]);
                send(SIGNATURE[1]);
                send(SIGNATURE[2]);
            }
            command::LEAVE_PROGMODE => set_watchdog(Timeout::Soon),
            _ => {}
        }
        send(OK);
    }
}

/// Receives `left` parameters and the end of the command, and begins the answer.
#[inline(never)]
fn take_parameters(mut left: u8) {
    let mut to = received();
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
    unsafe { asm!("wdr", options(nomem, nostack, preserves_flags)) };
    UDR0.read()
}
