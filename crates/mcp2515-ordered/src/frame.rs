//! A CAN 2.0B extended data frame.

/// An extended data frame of up to eight bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// How many bytes of `data` count: 0 to 8.
    pub len: u8,
    /// The 29-bit identifier, most significant byte first. Bytes and not an `u32`, because the AVR shifts that one bit at
    /// a time.
    ///
    /// The three highest bits are zero, but for [`FOREIGN`](Self::FOREIGN) in a received frame of another kind.
    pub id: [u8; 4],
    /// The bytes, with whatever follows them.
    pub data: [u8; Frame::MAX_LEN],
}

impl Frame {
    /// Bytes that fit in a frame of classic CAN.
    pub const MAX_LEN: usize = 8;

    /// In the first byte of `id`: the frame that was received has a standard identifier or is a remote frame. The driver delivers it
    /// because it takes up a buffer of the chip; the other bits of `id` are an identifier only if it is an extended one. Filters for extended
    /// identifiers keep standard frames out; no filter keeps remote frames out.
    pub const FOREIGN: u8 = 1 << 7;

    /// Identifier zero, no bytes.
    pub const EMPTY: Self = Self { id: [0; 4], len: 0, data: [0; Self::MAX_LEN] };

    /// A standard or a remote frame: see [`FOREIGN`](Self::FOREIGN).
    #[inline(always)]
    pub const fn is_foreign(&self) -> bool {
        self.id[0] & Self::FOREIGN != 0
    }

    /// Adds a byte. One more than fit is counted in `len`, and lost.
    #[inline(never)]
    pub fn push(&mut self, byte: u8) {
        if let Some(place) = self.data.get_mut(usize::from(self.len)) {
            *place = byte;
        }
        self.len = self.len.wrapping_add(1);
    }

    /// The bytes of the frame: all that there are where `len` is larger.
    pub fn data(&self) -> &[u8] {
        // `get` because an index here would link a panic.
        self.data.get(..usize::from(self.len)).unwrap_or(&self.data)
    }
}

impl embedded_can::Frame for Frame {
    /// `None` for a standard identifier, and for more than eight bytes.
    fn new(id: impl Into<embedded_can::Id>, bytes: &[u8]) -> Option<Self> {
        let embedded_can::Id::Extended(id) = id.into() else {
            return None;
        };
        let mut data = [0; Self::MAX_LEN];
        data.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(Self { id: id.as_raw().to_be_bytes(), len: bytes.len() as u8, data })
    }

    /// `None`: the crate sends data frames only.
    fn new_remote(_id: impl Into<embedded_can::Id>, _dlc: usize) -> Option<Self> {
        None
    }

    /// True, also if it [`is_foreign`](Self::is_foreign).
    fn is_extended(&self) -> bool {
        true
    }

    fn is_remote_frame(&self) -> bool {
        false
    }

    fn id(&self) -> embedded_can::Id {
        let [high, rest @ ..] = self.id;
        let raw = u32::from_be_bytes([high & 0x1F, rest[0], rest[1], rest[2]]);
        // The mask keeps it in range; zero only satisfies the type.
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
    fn only_the_bytes_that_count_are_data() {
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
