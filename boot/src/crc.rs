//! CRC-16-CCITT-FALSE: of transfers, of records, and of the program.

use core::arch::{asm, global_asm};

// `crc_add` adds the byte in r22 to the CRC in r25:r24, and changes r18 and r22. It shifts the CRC
// left eight times, and subtracts the polynomial 0x1021 each time that a bit leaves.
// `dronecan_wire::crc` is faster, and twice as long.
//
// `crc_of` adds as many bytes as X says, which is not zero, from Z on. It changes X and Z, too.
global_asm!(
    "crc_of:",
    "    ld r22, Z+",
    "    rcall crc_add",
    "    sbiw r26, 1",
    "    brne crc_of",
    "    ret",
    "crc_add:",
    "    eor r25, r22",
    "    ldi r18, 8",
    "1:  lsl r24",
    "    rol r25",
    "    brcc 2f",
    "    ldi r22, 0x10",
    "    eor r25, r22",
    "    ldi r22, 0x21",
    "    eor r24, r22",
    "2:  dec r18",
    "    brne 1b",
    "    ret",
);

/// Returns the CRC after one more byte.
#[inline(always)]
pub fn add(mut crc: u16, byte: u8) -> u16 {
    // SAFETY: the block changes only the registers that `crc_add` names.
    unsafe {
        asm!("rcall crc_add", inout("r25r24") crc, inout("r22") byte => _, out("r18") _);
    }
    crc
}

/// Returns the CRC of `len` bytes, which are not zero, from `bytes` on.
///
/// # Safety
///
/// The bytes must be readable.
#[inline(always)]
pub unsafe fn of(seed: u16, bytes: *const u8, len: u16) -> u16 {
    let mut crc = seed;
    // SAFETY: the caller guarantees that the bytes are readable. The block changes only the
    // registers that `crc_of` names.
    unsafe {
        asm!("rcall crc_of", inout("r25r24") crc, inout("Z") bytes => _, inout("X") len => _,
            out("r18") _, out("r22") _);
    }
    crc
}
