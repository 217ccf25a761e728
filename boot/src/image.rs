//! The program in flash: whether it is whole and for this board.

use core::arch::asm;

use firmware::handover::{CRC_START, HEADER, HEADER_LENGTH};
use firmware::hardware::{HARDWARE_MAJOR, HARDWARE_MINOR};

use crate::crc;
use crate::spm::PAGE_LEN;

/// Byte address of the boot section, which is behind the program.
pub const BOOT_SECTION: u16 = match u16::from_str_radix(env!("BOOT_SECTION"), 10) {
    Ok(address) => address,
    Err(_) => panic!("the boot section is in the first 64 KB"),
};

/// Major and minor hardware version, as in the header of a program.
pub const THIS_BOARD: u16 = u16::from_le_bytes([HARDWARE_MAJOR, HARDWARE_MINOR]);

/// True if a program of this length can be checked and fits below the boot section. False for the
/// zero of a program without a length.
#[inline(always)]
pub fn is_checkable(length: u16) -> bool {
    // More than a page, because the first one is written by itself.
    length.wrapping_sub(PAGE_LEN + 1) < BOOT_SECTION - PAGE_LEN
}

/// True if the program is for this board and whole. While an upload or an update is incomplete, the
/// header is that of the old program, or that of the new one, or erased. Each time the CRC of what
/// the flash has is wrong.
#[inline(always)]
pub fn is_valid() -> bool {
    let length = read_flash(HEADER + HEADER_LENGTH as u16);
    if read_flash(HEADER) != THIS_BOARD || !is_checkable(length) {
        return false;
    }
    let mut crc = CRC_START;
    let mut address = 0;
    loop {
        crc = crc::add(crc, read_next(&mut address));
        if address == length {
            return crc == 0;
        }
    }
}

/// Reads a word of the flash, little-endian, from a byte address on.
#[inline(always)]
pub fn read_flash(address: u16) -> u16 {
    let word;
    // SAFETY: LPM only reads flash and changes no memory, whatever the address.
    unsafe {
        asm!("lpm {0:l}, Z+", "lpm {0:h}, Z", out(reg_pair) word, inout("Z") address => _,
            options(pure, readonly, nostack, preserves_flags));
    }
    word
}

/// Reads a byte of the flash, and moves the byte address to the next one.
#[inline(always)]
pub fn read_next(address: &mut u16) -> u8 {
    let byte;
    // SAFETY: as in `read_flash`.
    unsafe {
        asm!("lpm {0}, Z+", out(reg) byte, inout("Z") *address,
            options(pure, readonly, nostack, preserves_flags));
    }
    byte
}
