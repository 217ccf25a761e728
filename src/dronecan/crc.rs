//! The CRC of multi-frame transfers: CRC-16-CCITT-FALSE, polynomial 0x1021, not reflected (specification, chapter 4).
//!
//! It runs over the 64-bit signature of the data type and then the payload. Only what it amounts to after the signature is
//! kept, as the seed of each type.

/// The CRC after one more byte.
#[inline(never)]
pub fn add(crc: u16, byte: u8) -> u16 {
    // A byte at a time without a table, which would take 512 bytes of flash: the quotient's two nibbles depend on each other.
    let mut x = (crc >> 8) as u8 ^ byte;
    x ^= x >> 4;
    (crc << 8) ^ u16::from(x) << 12 ^ u16::from(x) << 5 ^ u16::from(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crc(init: u16, bytes: &[u8]) -> u16 {
        bytes.iter().fold(init, |crc, &byte| add(crc, byte))
    }

    #[test]
    fn the_check_value_is_that_of_the_algorithm() {
        assert_eq!(crc(0xFFFF, b"123456789"), 0x29B1);
    }
}
