//! A CAN 2.0B frame of any kind.

use embedded_can::{ExtendedId, Id, StandardId};

use crate::filters::{sidh, sidl};
use crate::frame::Frame;
use crate::registers::{DLC, IDE, RTR, SRR};

/// A data or remote frame with a standard or extended identifier, for
/// [`receive_any`](crate::Driver::receive_any), [`transmit_any`](crate::Driver::transmit_any) and
/// the traits of [`embedded_can`]. [`Frame`] is for extended data frames only, and is faster.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AnyFrame {
    /// The identifier, most significant byte first: of 29 bits if it is extended, else of 11.
    id: [u8; 4],
    is_extended: bool,
    is_remote: bool,
    /// 0 to 8. A remote frame has a length, but no data.
    len: u8,
    data: [u8; Frame::MAX_LEN],
}

impl AnyFrame {
    fn new(id: Id, is_remote: bool, len: usize, data: [u8; Frame::MAX_LEN]) -> Self {
        let (raw, is_extended) = match id {
            Id::Standard(id) => (u32::from(id.as_raw()), false),
            Id::Extended(id) => (id.as_raw(), true),
        };
        Self { id: raw.to_be_bytes(), is_extended, is_remote, len: len as u8, data }
    }

    /// Converts SIDH, SIDL, EID8 and EID0 in place of the identifier, and RXBnDLC (DS20001801J
    /// registers 4-4 to 4-8).
    pub(crate) fn from_registers(registers: &Frame, dlc: u8) -> Self {
        let &Frame { id: [sidh, sidl, eid8, eid0], len, .. } = registers;
        let is_extended = sidl & IDE != 0;
        let (id, is_remote) = if is_extended {
            let second = sidh << 5 | (sidl >> 3) & 0b1_1100 | sidl & 0b11;
            ([sidh >> 3, second, eid8, eid0], dlc & RTR != 0)
        } else {
            ([0, 0, sidh >> 5, sidh << 3 | sidl >> 5], sidl & SRR != 0)
        };
        // The chip leaves the bytes after the first `len` as they were.
        let mut data = [0; Frame::MAX_LEN];
        data.iter_mut().zip(registers.data()).for_each(|(place, byte)| *place = *byte);
        Self { id, is_extended, is_remote, len, data }
    }

    /// Returns the frame with SIDH, SIDL, EID8 and EID0 in place of the identifier, and TXBnDLC
    /// (DS20001801J registers 3-3 to 3-7).
    pub(crate) fn to_registers(self) -> (Frame, u8) {
        let Self { id: [b3, b2, b1, b0], len, data, .. } = self;
        let id = if self.is_extended {
            [sidh(b3, b2), sidl(b2), b1, b0]
        } else {
            [b1 << 5 | b0 >> 3, b0 << 5, 0, 0]
        };
        let rtr = if self.is_remote { RTR } else { 0 };
        (Frame { id, len, data }, rtr | len & DLC)
    }

    /// The frame as an extended data frame. `None` if it is of another kind.
    pub fn extended_data(&self) -> Option<Frame> {
        (self.is_extended && !self.is_remote).then_some(Frame {
            id: self.id,
            len: self.len,
            data: self.data,
        })
    }
}

impl From<Frame> for AnyFrame {
    /// The frame must not be [foreign](Frame::is_foreign): its kind is unknown.
    fn from(frame: Frame) -> Self {
        let Frame { id: [high, rest @ ..], len, data } = frame;
        let [b2, b1, b0] = rest;
        let len = len.min(Frame::MAX_LEN as u8);
        Self { id: [high & 0x1F, b2, b1, b0], is_extended: true, is_remote: false, len, data }
    }
}

impl embedded_can::Frame for AnyFrame {
    /// Returns `None` for more than eight bytes.
    fn new(id: impl Into<Id>, bytes: &[u8]) -> Option<Self> {
        let mut data = [0; Frame::MAX_LEN];
        data.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(Self::new(id.into(), false, bytes.len(), data))
    }

    /// Returns `None` for a length above 8.
    fn new_remote(id: impl Into<Id>, dlc: usize) -> Option<Self> {
        let data = [0; Frame::MAX_LEN];
        (dlc <= Frame::MAX_LEN).then(|| Self::new(id.into(), true, dlc, data))
    }

    fn is_extended(&self) -> bool {
        self.is_extended
    }

    fn is_remote_frame(&self) -> bool {
        self.is_remote
    }

    fn id(&self) -> Id {
        let raw = u32::from_be_bytes(self.id);
        // The identifier is always in range, so the fallbacks to zero never apply.
        if self.is_extended {
            ExtendedId::new(raw).unwrap_or(ExtendedId::ZERO).into()
        } else {
            StandardId::new(raw as u16).unwrap_or(StandardId::ZERO).into()
        }
    }

    fn dlc(&self) -> usize {
        usize::from(self.len)
    }

    /// The data. A remote frame has none.
    fn data(&self) -> &[u8] {
        let len = if self.is_remote { 0 } else { usize::from(self.len) };
        self.data.get(..len).unwrap_or(&self.data)
    }
}

#[cfg(test)]
mod tests {
    use embedded_can::Frame as _;

    use super::*;

    fn standard(raw: u16) -> Id {
        StandardId::new(raw).unwrap().into()
    }

    fn extended(raw: u32) -> Id {
        ExtendedId::new(raw).unwrap().into()
    }

    /// Register 3-3 has the upper eight bits of a standard identifier, register 3-4 the lower three
    /// from bit 5 on.
    #[test]
    fn the_registers_of_each_kind_are_those_of_the_data_sheet() {
        let of = |frame: AnyFrame| {
            let (registers, dlc) = frame.to_registers();
            (registers.id, dlc)
        };
        let new = |id, data: &[u8]| <AnyFrame as embedded_can::Frame>::new(id, data).unwrap();
        assert_eq!(of(new(standard(0x7FF), &[1, 2])), ([0xFF, 0xE0, 0, 0], 2));
        assert_eq!(of(new(standard(0x123), &[])), ([0x24, 0x60, 0, 0], 0));
        assert_eq!(of(new(extended(0x1FFF_FFFF), &[1])), ([0xFF, 0xEB, 0xFF, 0xFF], 1));
        assert_eq!(of(AnyFrame::new_remote(standard(1), 8).unwrap()), ([0, 0x20, 0, 0], 0x48));
    }

    #[test]
    fn a_frame_too_long_is_none_and_a_remote_frame_has_a_length_without_data() {
        assert!(<AnyFrame as embedded_can::Frame>::new(standard(1), &[0; 9]).is_none());
        assert!(AnyFrame::new_remote(standard(1), 9).is_none());
        let remote = AnyFrame::new_remote(extended(5), 3).unwrap();
        assert_eq!((remote.dlc(), remote.data(), remote.id()), (3, &[][..], extended(5)));
        assert_eq!(remote.extended_data(), None);
    }

    #[test]
    fn an_extended_data_frame_converts_both_ways() {
        let frame = Frame { id: [0x10, 0x03, 0xF2, 0x0A], len: 3, data: [1, 2, 3, 0, 0, 0, 0, 0] };
        let any = AnyFrame::from(frame);
        assert_eq!((any.id(), any.data()), (extended(0x1003_F20A), &[1, 2, 3][..]));
        assert_eq!(any.extended_data(), Some(frame));
    }
}
