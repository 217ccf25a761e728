//! The CRC of multi-frame transfers: CRC-16-CCITT-FALSE, polynomial 0x1021, not reflected
//! (specification, chapter 4).
//!
//! The CRC covers the 64-bit signature of the data type and then the payload. The value after the
//! signature is the *seed* of the type, which a program can compute at compile time: see [`seed`]
//! and [`types`](crate::types).

/// Returns the CRC after one more byte.
#[inline(never)]
pub fn add(crc: u16, byte: u8) -> u16 {
    step(crc, byte)
}

/// Computes the seed of the data type with this signature.
pub const fn seed(signature: u64) -> u16 {
    let bytes = signature.to_le_bytes();
    let (mut crc, mut n) = (0xFFFF, 0);
    while n < bytes.len() {
        crc = step(crc, bytes[n]);
        n += 1;
    }
    crc
}

/// Does the same as [`add`], but inlined: for fast loops and for constants.
#[inline(always)]
pub const fn step(crc: u16, byte: u8) -> u16 {
    // Divides a byte at a time, without a table. The quotient is the byte that leaves at the top,
    // with its high nibble added to its low nibble. The polynomial 0x1021 adds the quotient in
    // three places. An AVR computes with bytes faster than with words.
    let [low, high] = crc.to_le_bytes();
    let mut x = high ^ byte;
    x ^= x >> 4;
    u16::from_le_bytes([x ^ x << 5, low ^ x << 4 ^ x >> 3])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crc(init: u16, bytes: &[u8]) -> u16 {
        bytes.iter().fold(init, |crc, &byte| add(crc, byte))
    }

    #[test]
    fn the_check_value_of_the_algorithm_is_right() {
        assert_eq!(crc(0xFFFF, b"123456789"), 0x29B1);
    }

    #[test]
    fn the_seed_is_the_crc_of_the_signature_lowest_byte_first() {
        for signature in [0, 1, 0x0F08_68D0_C1A7_C6F1, u64::MAX] {
            assert_eq!(seed(signature), crc(0xFFFF, &signature.to_le_bytes()), "{signature:016X}");
        }
    }
}
