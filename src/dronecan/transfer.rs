//! The tail byte, and transfers of one frame (specification, chapter 4).
//!
//! ```text
//! tail: start_of_transfer[7] end_of_transfer[6] toggle[5] transfer_id[4:0]
//! ```

use crate::can::Frame;

const START_OF_TRANSFER: u8 = 1 << 7;
const END_OF_TRANSFER: u8 = 1 << 6;
const TOGGLE: u8 = 1 << 5;

/// Payload bytes beside the tail byte.
pub const SINGLE_FRAME_PAYLOAD: usize = Frame::MAX_LEN - 1;

/// Counts the transfers of one type: 0 to 31, then 0 again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TransferId(u8);

impl TransferId {
    const MASK: u8 = 31;

    /// Of the first transfer of a type.
    pub const FIRST: Self = Self(0);

    /// The current number; counts on for the next transfer.
    pub fn take(&mut self) -> Self {
        let current = *self;
        self.0 = (self.0 + 1) & Self::MASK;
        current
    }

    /// 0 to 31.
    pub fn get(self) -> u8 {
        self.0
    }
}

/// A received transfer of one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SingleFrame<'a> {
    /// Its number.
    pub transfer_id: TransferId,
    /// What it carries.
    pub payload: &'a [u8],
}

impl<'a> SingleFrame<'a> {
    /// `None` if the frame has no tail byte, or one of a longer transfer.
    pub fn parse(data: &'a [u8]) -> Option<Self> {
        let (&tail, payload) = data.split_last()?;
        if tail & (START_OF_TRANSFER | END_OF_TRANSFER | TOGGLE) != START_OF_TRANSFER | END_OF_TRANSFER {
            return None;
        }
        Some(Self { transfer_id: TransferId(tail & TransferId::MASK), payload })
    }
}

/// The payload of a transfer of one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Payload {
    data: [u8; Frame::MAX_LEN],
    len: u8,
}

impl Payload {
    /// At most seven bytes.
    pub fn new<const N: usize>(bytes: [u8; N]) -> Self {
        const { assert!(N <= SINGLE_FRAME_PAYLOAD) }
        let mut data = [0; Frame::MAX_LEN];
        let (start, _) = data.split_at_mut(N);
        start.copy_from_slice(&bytes);
        Self { data, len: N as u8 }
    }
}

/// A frame that carries a whole transfer.
pub fn single_frame(id: u32, transfer_id: TransferId, mut payload: Payload) -> Frame {
    if let Some(tail) = payload.data.get_mut(usize::from(payload.len)) {
        *tail = START_OF_TRANSFER | END_OF_TRANSFER | transfer_id.0;
    }
    Frame::new(id, payload.data, payload.len + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_whole_transfer_in_one_frame_is_parsed() {
        let transfer = SingleFrame::parse(&[1, 0, 0, 0x38, 0xC7]).unwrap();
        assert_eq!((transfer.transfer_id.get(), transfer.payload), (7, &[1, 0, 0, 0x38][..]));
        assert_eq!(SingleFrame::parse(&[0xDF]).unwrap().payload, []);
        for tail in [0x80, 0x40, 0x00, 0xE0, 0x20, 0x60, 0xA0] {
            assert_eq!(SingleFrame::parse(&[1, tail]), None, "tail {tail:02X}");
        }
        assert_eq!(SingleFrame::parse(&[]), None);
    }

    #[test]
    fn transfer_ids_count_to_31_and_start_over() {
        let mut id = TransferId::default();
        for expected in (0..32).chain(0..3) {
            assert_eq!(id.take().get(), expected);
        }
    }
}
