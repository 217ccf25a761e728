//! Fields that do not begin at a byte boundary.
//!
//! The bytes of a field come lowest first, each from its most significant bit. A last byte that is
//! not full has only its low bits (DSDL, "Data serialization").

/// Writes consecutive fields.
#[derive(Default)]
pub struct Writer {
    bytes: Vec<u8>,
    /// Number of bits in use.
    len: usize,
}

impl Writer {
    /// Writes the low `width` bits of a number.
    pub fn put(&mut self, value: u64, width: u32) {
        for (byte, bits) in value.to_le_bytes().into_iter().zip(widths(width)) {
            for bit in (0..bits).rev() {
                self.bit(byte >> bit & 1 != 0);
            }
        }
    }

    /// Writes whole bytes.
    pub fn put_bytes(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.put(u64::from(*byte), 8));
    }

    fn bit(&mut self, bit: bool) {
        if self.len.is_multiple_of(8) {
            self.bytes.push(0);
        }
        if bit {
            self.bytes[self.len / 8] |= 0x80 >> (self.len % 8);
        }
        self.len += 1;
    }

    /// The fields, padded with zeros to a whole byte.
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }
}

/// Reads consecutive fields.
pub struct Reader<'a> {
    bytes: &'a [u8],
    /// Number of bits read.
    taken: usize,
}

impl<'a> Reader<'a> {
    /// Starts at the first bit.
    pub fn new(bytes: &'a [u8]) -> Reader<'a> {
        Reader { bytes, taken: 0 }
    }

    /// Reads a number of `width` bits, at most 64; `None` if fewer are left.
    pub fn take(&mut self, width: u32) -> Option<u64> {
        let mut value = [0; 8];
        for (byte, bits) in value.iter_mut().zip(widths(width)) {
            for _ in 0..bits {
                *byte = *byte << 1 | u8::from(self.bit()?);
            }
        }
        Some(u64::from_le_bytes(value))
    }

    /// Reads `count` whole bytes.
    pub fn take_bytes(&mut self, count: usize) -> Option<Vec<u8>> {
        (0..count).map(|_| self.take(8).map(|byte| byte as u8)).collect()
    }

    /// All remaining whole bytes.
    pub fn rest(&mut self) -> Vec<u8> {
        let count = (self.bytes.len() * 8 - self.taken) / 8;
        self.take_bytes(count).unwrap_or_default()
    }

    /// True if all are read.
    pub fn is_empty(&self) -> bool {
        self.taken == self.bytes.len() * 8
    }

    fn bit(&mut self) -> Option<bool> {
        let byte = self.bytes.get(self.taken / 8)?;
        let bit = byte & 0x80 >> (self.taken % 8) != 0;
        self.taken += 1;
        Some(bit)
    }
}

/// The number of bits in each byte of a field.
fn widths(width: u32) -> impl Iterator<Item = u32> {
    (0..width).step_by(8).map(move |from| (width - from).min(8))
}
