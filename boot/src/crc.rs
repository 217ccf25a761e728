//! CRC-16-CCITT-FALSE: of transfers, of records, and of the program.

use core::arch::asm;

/// Returns the CRC after one more byte. `dronecan_wire::crc` is faster, and twice as long.
#[inline(never)]
pub fn add(crc: u16, byte: u8) -> u16 {
    let after;
    // Shifts the CRC left eight times. Subtracts the polynomial 0x1021 each time that a bit leaves.
    // SAFETY: the block changes only its operands.
    unsafe {
        asm!(
            "eor {crc:h}, {byte}",
            "ldi {bits}, 8",
            "2: lsl {crc:l}",
            "rol {crc:h}",
            "brcc 3f",
            "ldi {byte}, 0x10",
            "eor {crc:h}, {byte}",
            "ldi {byte}, 0x21",
            "eor {crc:l}, {byte}",
            "3: dec {bits}",
            "brne 2b",
            crc = inout(reg_pair) crc => after,
            byte = inout(reg_upper) byte => _,
            bits = out(reg_upper) _,
            options(pure, nomem, nostack)
        );
    }
    after
}

/// Returns the CRC of `len` bytes, which are not zero, from `bytes` on.
///
/// # Safety
///
/// The bytes must be readable.
#[inline(never)]
pub unsafe fn of(seed: u16, mut bytes: *const u8, mut len: u16) -> u16 {
    let mut crc = seed;
    loop {
        // SAFETY: the caller guarantees that the bytes are readable.
        unsafe {
            crc = add(crc, *bytes);
            bytes = bytes.add(1);
        }
        len -= 1;
        if len == 0 {
            return crc;
        }
    }
}
