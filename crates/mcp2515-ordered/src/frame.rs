//! A CAN 2.0B extended data frame.

/// An extended data frame of up to eight bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Frame {
    /// Number of valid bytes in `data`: 0 to 8.
    pub len: u8,
    /// The 29-bit identifier, most significant byte first. It is bytes and not a `u32`, because an
    /// AVR shifts one bit at a time.
    ///
    /// The three highest bits are zero, except [`FOREIGN`](Self::FOREIGN) in a received standard
    /// or remote frame.
    pub id: [u8; 4],
    /// The data bytes. The bytes after the first `len` are undefined.
    pub data: [u8; Frame::MAX_LEN],
}

impl Frame {
    /// Data bytes of a classic CAN frame at most.
    pub const MAX_LEN: usize = 8;

    /// Bit in the first byte of `id`: the received frame has a standard identifier, or is a remote
    /// frame. The driver returns the frame because it occupies a buffer of the chip. The other
    /// bits of `id` are valid only for an extended identifier. Filters for extended identifiers
    /// reject standard frames; no filter rejects remote frames.
    pub const FOREIGN: u8 = 1 << 7;

    /// A frame with identifier zero and no data.
    pub const EMPTY: Self = Self { id: [0; 4], len: 0, data: [0; Self::MAX_LEN] };

    /// True for a standard or a remote frame: see [`FOREIGN`](Self::FOREIGN).
    pub const fn is_foreign(&self) -> bool {
        self.id[0] & Self::FOREIGN != 0
    }

    /// Adds a byte. A byte that does not fit is dropped, but counted in `len`.
    #[inline(never)]
    pub fn push(&mut self, byte: u8) {
        if let Some(place) = self.data.get_mut(usize::from(self.len)) {
            *place = byte;
        }
        self.len = self.len.wrapping_add(1);
    }

    /// The data of the frame: the first `len` bytes, or all eight if `len` is larger.
    pub fn data(&self) -> &[u8] {
        // `get` and not an index, because an index adds a panic to the program.
        self.data.get(..usize::from(self.len)).unwrap_or(&self.data)
    }
}

impl embedded_can::Frame for Frame {
    /// Returns `None` for a standard identifier, and for more than eight bytes.
    fn new(id: impl Into<embedded_can::Id>, bytes: &[u8]) -> Option<Self> {
        let embedded_can::Id::Extended(id) = id.into() else {
            return None;
        };
        let mut data = [0; Self::MAX_LEN];
        data.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(Self { id: id.as_raw().to_be_bytes(), len: bytes.len() as u8, data })
    }

    /// Returns `None`: the crate sends data frames only.
    fn new_remote(_id: impl Into<embedded_can::Id>, _dlc: usize) -> Option<Self> {
        None
    }

    /// Returns true, also if the frame [`is_foreign`](Self::is_foreign).
    fn is_extended(&self) -> bool {
        true
    }

    fn is_remote_frame(&self) -> bool {
        false
    }

    fn id(&self) -> embedded_can::Id {
        let [high, rest @ ..] = self.id;
        let raw = u32::from_be_bytes([high & 0x1F, rest[0], rest[1], rest[2]]);
        // The mask keeps the value in range, so the fallback to zero never applies.
        embedded_can::ExtendedId::new(raw).unwrap_or(embedded_can::ExtendedId::ZERO).into()
    }

    fn dlc(&self) -> usize {
        self.data().len()
    }

    fn data(&self) -> &[u8] {
        self.data()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_can::{ExtendedId, Frame as _, StandardId};

    #[test]
    fn bytes_are_appended_and_those_that_do_not_fit_are_counted() {
        let mut frame = Frame::EMPTY;
        for byte in 1..=9 {
            frame.push(byte);
        }
        assert_eq!((frame.len, frame.data()), (9, &[1, 2, 3, 4, 5, 6, 7, 8][..]));
    }

    #[test]
    fn the_most_significant_bit_of_an_identifier_marks_a_foreign_frame() {
        let foreign = |first| Frame { id: [first, 0xFF, 0xFF, 0xFF], ..Frame::EMPTY }.is_foreign();
        assert!(foreign(0x80) && foreign(0x9F) && !foreign(0x1F) && !foreign(0));
    }

    #[test]
    fn only_the_first_len_bytes_are_data() {
        let frame = |len| Frame { id: [0; 4], len, data: [1, 2, 3, 4, 5, 6, 7, 8] };
        assert_eq!(frame(0).data(), []);
        assert_eq!(frame(3).data(), [1, 2, 3]);
        assert_eq!(frame(8).data(), [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(frame(200).data(), [1, 2, 3, 4, 5, 6, 7, 8]);
    }

    #[test]
    fn embedded_can_sees_an_extended_data_frame() {
        let id = ExtendedId::new(0x1003_F20A).unwrap();
        let frame = <Frame as embedded_can::Frame>::new(id, &[1, 0, 0, 0x38, 0xC7]).unwrap();
        assert_eq!(frame.id, [0x10, 0x03, 0xF2, 0x0A]);
        assert_eq!(embedded_can::Frame::id(&frame), id.into());
        assert_eq!((frame.dlc(), frame.is_extended(), frame.is_data_frame()), (5, true, true));
        assert!(<Frame as embedded_can::Frame>::new(id, &[0; 9]).is_none());
        assert!(<Frame as embedded_can::Frame>::new(StandardId::ZERO, &[]).is_none());
        assert!(<Frame as embedded_can::Frame>::new_remote(id, 0).is_none());
    }
}
