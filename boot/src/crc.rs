//! CRC-16-CCITT-FALSE: of transfers, of records, and of the program.

/// Returns the CRC after one more byte. `dronecan_wire::crc` is faster and longer.
#[inline(never)]
pub fn add(crc: u16, byte: u8) -> u16 {
    let mut crc = crc ^ u16::from(byte) << 8;
    let mut bits = 8u8;
    loop {
        let is_carry = crc & 0x8000 != 0;
        crc <<= 1;
        if is_carry {
            crc ^= 0x1021;
        }
        bits -= 1;
        if bits == 0 {
            return crc;
        }
    }
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
