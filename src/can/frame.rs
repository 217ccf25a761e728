//! A CAN 2.0B extended data frame, the only kind that DroneCAN uses (specification, chapter 4).

/// An extended data frame of up to eight bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    id: u32,
    len: u8,
    data: [u8; Frame::MAX_LEN],
}

impl Frame {
    /// Bytes that fit in a frame of classic CAN.
    pub const MAX_LEN: usize = 8;

    /// Bits of an extended identifier.
    pub const ID_MASK: u32 = 0x1FFF_FFFF;

    /// A frame with the low 29 bits of `id` and the first `len` bytes of `data` (all eight where `len` is larger).
    pub fn new(id: u32, data: [u8; Self::MAX_LEN], len: u8) -> Self {
        Self { id: id & Self::ID_MASK, len: len.min(Self::MAX_LEN as u8), data }
    }

    /// The 29-bit identifier.
    pub fn id(&self) -> u32 {
        self.id
    }

    /// The bytes of the frame.
    pub fn data(&self) -> &[u8] {
        // `get` because an index here would link a panic for a length that `new` has bounded.
        self.data.get(..usize::from(self.len)).unwrap_or(&self.data)
    }

    /// The bytes of the frame with whatever follows them, and how many of them count.
    pub fn padded(&self) -> (&[u8; Self::MAX_LEN], u8) {
        (&self.data, self.len)
    }
}

impl embedded_can::Frame for Frame {
    /// `None` for a standard identifier: DroneCAN has no use for one.
    fn new(id: impl Into<embedded_can::Id>, bytes: &[u8]) -> Option<Self> {
        let embedded_can::Id::Extended(id) = id.into() else {
            return None;
        };
        let mut data = [0; Self::MAX_LEN];
        data.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(Self::new(id.as_raw(), data, bytes.len() as u8))
    }

    /// `None`: remote frames are no part of DroneCAN.
    fn new_remote(_id: impl Into<embedded_can::Id>, _dlc: usize) -> Option<Self> {
        None
    }

    fn is_extended(&self) -> bool {
        true
    }

    fn is_remote_frame(&self) -> bool {
        false
    }

    fn id(&self) -> embedded_can::Id {
        // The mask in `Frame::new` keeps the identifier in range; zero only satisfies the type.
        embedded_can::ExtendedId::new(self.id).unwrap_or(embedded_can::ExtendedId::ZERO).into()
    }

    fn dlc(&self) -> usize {
        usize::from(self.len)
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
    fn frame_keeps_only_what_fits_on_the_wire() {
        let frame = Frame::new(0xFFFF_FFFF, [0xA5; 8], 200);
        assert_eq!(frame.id(), 0x1FFF_FFFF);
        assert_eq!(frame.data(), [0xA5; 8]);
        assert_eq!(Frame::new(1, [0xA5; 8], 0).data(), []);
        assert_eq!(Frame::new(1, [1, 2, 3, 4, 5, 6, 7, 8], 3).data(), [1, 2, 3]);
    }

    #[test]
    fn embedded_can_sees_an_extended_data_frame() {
        let id = ExtendedId::new(0x1003_F20A).unwrap();
        let frame = <Frame as embedded_can::Frame>::new(id, &[1, 0, 0, 0x38, 0xC7]).unwrap();
        assert_eq!(embedded_can::Frame::id(&frame), id.into());
        assert_eq!((frame.dlc(), frame.is_extended(), frame.is_data_frame()), (5, true, true));
        assert!(<Frame as embedded_can::Frame>::new(id, &[0; 9]).is_none());
        assert!(<Frame as embedded_can::Frame>::new(StandardId::ZERO, &[]).is_none());
        assert!(<Frame as embedded_can::Frame>::new_remote(id, 0).is_none());
    }
}
