//! Writes the flash, a page at a time (datasheet 27, "Boot Loader Support").
//!
//! Only code in the boot section can do this. While a page below the NRWW section is erased or
//! written, nothing can be read from there, and the loader goes on; while a page in the NRWW
//! section is, the processor halts. Interrupts are disabled throughout.
//!
//! It is in assembly because SPM takes the word in r1:r0, where the compiler expects zero in r1.

use core::arch::{asm, global_asm};

use crate::registers::{PGERS, PGWRT, RWWSRE, SELFPRGEN};

/// Bytes in a page of both chips.
pub const PAGE_LEN: u16 = 128;

// `write_page` and `erase_page` take the byte address of a page in Z, and leave it there. They
// change r0, r18, r24 and r25. `write_page` takes the address of the bytes in X, and leaves the
// address behind them there.
//
// `do_spm` does SPM with the command in r24, when the SPM before it and a write to the EEPROM have
// ended. The chip ends both within 5 ms. SPMCSR is 0x37, with SELFPRGEN in bit 0; EECR is 0x1F,
// with EEPE in bit 1. SPM must follow OUT within four cycles. RWWSRE waits for the end of an erase
// or a write, after which the page can be read again.
global_asm!(
    "erase_page:",
    "    ldi r24, {erase}",
    "    rjmp 2f",
    "write_page:",
    "    rcall erase_page",
    "    ldi r25, {words}",
    "1:  ld r0, X+",
    "    ld r1, X+",
    "    ldi r24, {fill}",
    "    rcall do_spm",
    "    adiw r30, 2",
    "    dec r25",
    "    brne 1b",
    "    subi r30, {len}",
    "    sbci r31, 0",
    "    ldi r24, {write}",
    "2:  rcall do_spm",
    "    ldi r24, {enable}",
    "do_spm:",
    "    in r18, 0x37",
    "    sbrc r18, 0",
    "    rjmp do_spm",
    "    sbic 0x1F, 1",
    "    rjmp do_spm",
    "    out 0x37, r24",
    "    spm",
    "    clr r1",
    "    ret",
    erase = const PGERS | SELFPRGEN,
    fill = const SELFPRGEN,
    write = const PGWRT | SELFPRGEN,
    enable = const RWWSRE | SELFPRGEN,
    words = const PAGE_LEN / 2,
    len = const PAGE_LEN,
);

/// Erases the first page.
#[inline(always)]
pub fn erase_first_page() {
    // SAFETY: the first page is below the boot section. The block changes only the registers that
    // `erase_page` names.
    unsafe { asm!("rcall erase_page", in("Z") 0u16, out("r18") _, out("r24") _) };
}

/// Erases the page at a byte address below the boot section, and writes it. Returns the address
/// behind the bytes.
///
/// # Safety
///
/// [`PAGE_LEN`] bytes must be readable from `bytes` on.
#[inline(always)]
pub unsafe fn write_page(address: u16, bytes: *const u8) -> *const u8 {
    let behind;
    // SAFETY: the caller guarantees the bytes. The block changes only the registers that
    // `write_page` names.
    unsafe {
        asm!("rcall write_page", in("Z") address, inout("X") bytes => behind,
            out("r18") _, out("r24") _, out("r25") _);
    }
    behind
}
