//! The fields of a payload: integers of any number of bits, booleans, float16 and arrays. Each
//! field begins at the bit behind the last, the lower byte of a number first, and bits fill a byte
//! from its highest.
//!
//! ```
//! use dronecan_wire::fields::{Reader, Writer};
//! use dronecan_wire::float16;
//!
//! // uint16 serial, bool is_ready, int7 offset, float16[<=8] levels
//! let mut writer = Writer::new([0; 8]);
//! writer.unsigned(0x1234, 16).bool(true).signed(-3, 7);
//! writer.float16(float16::from_fixed(3, 1)).float16(float16::from_fixed(5, 1));
//! assert_eq!(writer.bytes(), [0x34, 0x12, 0xFD, 0x00, 0x3E, 0x00, 0x41]);
//!
//! let mut reader = Reader::new(writer.bytes());
//! assert_eq!(reader.unsigned(16), Some(0x1234));
//! assert_eq!((reader.bool(), reader.signed(7)), (Some(true), Some(-3)));
//! // The last array of a type has no length: it ends with the payload.
//! let mut levels = core::iter::from_fn(|| reader.float16());
//! assert_eq!(levels.next().map(|level| float16::to_fixed(level, 1)), Some(3));
//! assert_eq!((levels.next().is_some(), levels.next()), (true, None));
//! ```

/// Reads the fields of a payload, one after the other. `None` if the payload ends before.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    bytes: &'a [u8],
    /// Bits that were read.
    at: usize,
}

impl<'a> Reader<'a> {
    /// At the beginning of a payload.
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// An unsigned integer of at most 32 bits; of one of 64 bits the lower half comes first.
    pub fn unsigned(&mut self, bits: u8) -> Option<u32> {
        if usize::from(bits) > self.bytes.len() * 8 - self.at {
            return None;
        }
        let (mut value, mut done) = (0, 0);
        while done < bits {
            let part = (bits - done).min(8);
            value |= u32::from(self.part(part)) << done;
            done += part;
        }
        Some(value)
    }

    /// A signed integer of 1 to 32 bits.
    pub fn signed(&mut self, bits: u8) -> Option<i32> {
        let unused = u32::from(32 - bits);
        Some((self.unsigned(bits)? << unused) as i32 >> unused)
    }

    /// A boolean: one bit.
    pub fn bool(&mut self) -> Option<bool> {
        Some(self.unsigned(1)? != 0)
    }

    /// The bits of a float16, for [`float16`](crate::float16).
    pub fn float16(&mut self) -> Option<u16> {
        self.unsigned(16).map(|bits| bits as u16)
    }

    /// Bits without a meaning, `void` in the definition.
    pub fn skip(&mut self, bits: u8) {
        self.at = (self.at + usize::from(bits)).min(self.bytes.len() * 8);
    }

    /// The bytes that are left: an array of bytes, such as a text, at the end of a type.
    ///
    /// `None` if it does not begin with a byte.
    pub fn rest(&self) -> Option<&'a [u8]> {
        if self.at.is_multiple_of(8) { self.bytes.get(self.at / 8..) } else { None }
    }

    /// The next bits of at most a byte, which are in the payload.
    fn part(&mut self, bits: u8) -> u8 {
        let (byte, used) = (self.at / 8, (self.at % 8) as u32);
        let get = |at| u16::from(self.bytes.get(at).copied().unwrap_or(0));
        let both = get(byte) << 8 | get(byte + 1);
        self.at += usize::from(bits);
        ((both << used) >> (16 - u32::from(bits))) as u8
    }
}

/// Writes the fields of a payload of at most `N` bytes, one after the other. What does not fit is
/// left out.
#[derive(Clone, Debug)]
pub struct Writer<const N: usize> {
    bytes: [u8; N],
    /// Bits that were written.
    at: usize,
}

impl<const N: usize> Writer<N> {
    /// An empty payload; `bytes` must be zeros.
    pub const fn new(bytes: [u8; N]) -> Self {
        Self { bytes, at: 0 }
    }

    /// An unsigned integer of at most 32 bits; of one of 64 bits the lower half comes first.
    pub fn unsigned(&mut self, value: u32, bits: u8) -> &mut Self {
        let mut done = 0;
        while done < bits {
            let part = (bits - done).min(8);
            let byte = (value >> done) as u8 & (0xFF >> (8 - part));
            self.part(byte, part);
            done += part;
        }
        self
    }

    /// A signed integer of at most 32 bits.
    pub fn signed(&mut self, value: i32, bits: u8) -> &mut Self {
        self.unsigned(value as u32, bits)
    }

    /// A boolean: one bit.
    pub fn bool(&mut self, value: bool) -> &mut Self {
        self.unsigned(value.into(), 1)
    }

    /// The bits of a float16, from [`float16`](crate::float16).
    pub fn float16(&mut self, bits: u16) -> &mut Self {
        self.unsigned(bits.into(), 16)
    }

    /// Bytes, such as a text at the end of a type.
    pub fn array(&mut self, bytes: &[u8]) -> &mut Self {
        bytes.iter().for_each(|byte| self.part(*byte, 8));
        self
    }

    /// Bits without a meaning, `void` in the definition.
    pub fn skip(&mut self, bits: u8) -> &mut Self {
        self.unsigned(0, bits)
    }

    /// What was written. The last byte is filled with zeros.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.at.div_ceil(8)]
    }

    fn part(&mut self, value: u8, bits: u8) {
        let (byte, used) = (self.at / 8, (self.at % 8) as u32);
        if self.at + usize::from(bits) > N * 8 {
            return;
        }
        let [high, low] = (u16::from(value) << (16 - u32::from(bits)) >> used).to_be_bytes();
        for (at, part) in [(byte, high), (byte + 1, low)] {
            if let Some(place) = self.bytes.get_mut(at) {
                *place |= part;
            }
        }
        self.at += usize::from(bits);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::esc;
    use crate::golden::bytes;

    /// NodeStatus by pydronecan: uptime 0x12345678, health 1, mode 0, sub mode 0, vendor 0xBEEF.
    #[test]
    fn the_fields_of_a_node_status_are_where_pydronecan_has_them() {
        let payload = bytes("78 56 34 12 40 EF BE");
        let mut reader = Reader::new(&payload);
        let fields = [32, 2, 3, 3, 16].map(|bits| reader.unsigned(bits));
        assert_eq!(fields, [Some(0x1234_5678), Some(1), Some(0), Some(0), Some(0xBEEF)]);
        assert_eq!((reader.bool(), reader.rest()), (None, Some(&[][..])));
        let mut writer = Writer::new([0; 7]);
        for (value, bits) in [(0x1234_5678, 32), (1, 2), (0, 3), (0, 3), (0xBEEF, 16)] {
            writer.unsigned(value, bits);
        }
        assert_eq!(writer.bytes(), payload);
    }

    /// Written by pydronecan 1.0.27, and read by the firmware's own function.
    #[test]
    fn signed_integers_of_fourteen_bits_are_those_of_a_raw_command() {
        let payload = bytes("FF 7C 02 00 00 00 40 FF FC 01 03 44 95 55");
        let mut reader = Reader::new(&payload);
        let read: [_; 8] = std::array::from_fn(|_| reader.signed(14));
        assert_eq!(read, [8191, -8192, 0, 1, -1, 4096, 4660, 5461].map(Some));
        assert_eq!(reader.signed(14), None);
        let mut writer = Writer::new([0; 14]);
        for (index, number) in (0..).zip(read) {
            assert_eq!(esc::raw_command(&payload, index).map(i32::from), number);
            writer.signed(number.unwrap(), 14);
        }
        assert_eq!(writer.bytes(), payload);
    }

    #[test]
    fn every_width_at_every_place_is_read_as_it_was_written() {
        for before in 0..=16 {
            for width in 1..=32 {
                let mut writer = Writer::new([0; 7]);
                let value = 0xA5C3_96F1_u32;
                writer.skip(before).unsigned(value, width).bool(true);
                let mut reader = Reader::new(writer.bytes());
                reader.skip(before);
                let expected = (u64::from(value) & ((1 << width) - 1)) as u32;
                assert_eq!(reader.unsigned(width), Some(expected), "{width} at {before}");
                assert_eq!(reader.bool(), Some(true), "{width} at {before}");
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_left_out_and_what_is_not_there_is_none() {
        let mut writer = Writer::new([0; 2]);
        writer.unsigned(3, 2).array(b"ab");
        assert_eq!(writer.bytes().len(), 2);
        let mut reader = Reader::new(writer.bytes());
        reader.skip(2);
        assert_eq!((reader.unsigned(8), reader.rest()), (Some(u32::from(b'a')), None));
        assert_eq!(reader.unsigned(8), None);
        reader.skip(200);
        assert_eq!(reader.rest(), Some(&[][..]));
    }
}
