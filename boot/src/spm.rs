//! Writes the flash, a page at a time (datasheet 27, "Boot Loader Support").
//!
//! Only code in the boot section can do this. While a page below the NRWW section is erased or
//! written, nothing can be read from there, and the loader goes on; while a page in the NRWW
//! section is, the processor halts. Interrupts are disabled throughout.

use core::arch::asm;

use crate::registers::{PGERS, PGWRT, RWWSRE, SELFPRGEN};

/// Bytes in a page of both chips.
pub const PAGE_LEN: u16 = 128;

/// SELFPRGEN alone: fill a word of the page buffer.
const FILL: u8 = 0;

/// The word of commands that have none.
const NO_WORD: u16 = 0;

/// Erases the page at a byte address.
#[inline(always)]
pub fn erase_page(address: u16) {
    do_spm(PGERS, address, NO_WORD);
    do_spm(RWWSRE, address, NO_WORD);
}

/// Erases the page at a byte address, and writes it with the bytes from `bytes` on.
///
/// # Safety
///
/// [`PAGE_LEN`] bytes must be readable from `bytes` on.
#[inline(never)]
pub unsafe fn write_page(mut address: u16, bytes: *const u8) {
    do_spm(PGERS, address, NO_WORD);
    // Backwards, so that the address is that of the page in the end, as PGWRT needs it.
    address = address.wrapping_add(PAGE_LEN);
    let mut bytes = bytes.wrapping_add(PAGE_LEN.into()).cast::<u16>();
    let mut words = PAGE_LEN as u8 / 2;
    loop {
        address = address.wrapping_sub(2);
        bytes = bytes.wrapping_sub(1);
        // SAFETY: the loop reads the bytes of one page.
        do_spm(FILL, address, unsafe { bytes.read_unaligned() });
        words -= 1;
        if words == 0 {
            break;
        }
    }
    do_spm(PGWRT, address, NO_WORD);
    // The page can be read again when it is written.
    do_spm(RWWSRE, address, NO_WORD);
}

/// Does SPM with a command and SELFPRGEN, when the one before it and a write to the EEPROM have
/// ended. The chip ends both within 5 ms. A word is for the page buffer only.
#[inline(never)]
fn do_spm(command: u8, address: u16, word: u16) {
    // SPMCSR is 0x37, with SELFPRGEN in bit 0; EECR is 0x1F, with EEPE in bit 1. SPM must follow
    // OUT within four cycles. SAFETY: SPM reads r1:r0, and changes only the page at `address`.
    // Callers pass addresses below the boot section. r1 is zero again afterwards.
    unsafe {
        asm!(
            "1: in r0, 0x37",
            "sbrc r0, 0",
            "rjmp 1b",
            "sbic 0x1F, 1",
            "rjmp 1b",
            "movw r0, {word}",
            "out 0x37, {command}",
            "spm",
            "clr r1",
            word = in(reg_pair) word,
            in("Z") address,
            command = in(reg) command | SELFPRGEN,
            options(nostack)
        );
    }
}
