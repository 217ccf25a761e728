//! The CRC of multi-frame transfers: CRC-16-CCITT-FALSE, polynomial 0x1021, not reflected (specification, chapter 4).
//!
//! It runs over the 64-bit signature of the data type and then the payload. Only what it amounts to after the signature is
//! kept, as the seed of each type.

/// The CRC after one more byte.
#[inline(never)]
pub fn add(crc: u16, byte: u8) -> u16 {
    step(crc, byte)
}

/// [`add`] for where it must be quick: in the place of the call, twice its size.
#[inline(always)]
pub const fn step(crc: u16, byte: u8) -> u16 {
    // A byte at a time, without a table of 512 bytes: the byte that leaves at the top, with its high nibble added to its low
    // one, is the quotient; the polynomial 0x1021 puts it in three places. In bytes, which are cheaper here than words.
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
    fn the_check_value_is_that_of_the_algorithm() {
        assert_eq!(crc(0xFFFF, b"123456789"), 0x29B1);
    }
}
