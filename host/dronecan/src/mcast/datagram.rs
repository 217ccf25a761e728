//! A CAN frame as a datagram of the multicast bus.
//!
//! ```text
//! offset  0      2      4       6                        10
//!         magic  crc    flags   identifier               data, 0 to 8 bytes    little endian
//!         0x2934        bit 0:  bit 31: it has 29 bits
//!                       CAN FD
//! ```
//! The CRC is CRC-16-CCITT-FALSE of all bytes after it. Source: pydronecan 1.0.27,
//! `driver/mcast.py`; libcanard, `drivers/mcast`.
//!
//! Limits: classic data frames. The format cannot represent a DLC above eight, and readers would
//! take a remote frame for a data frame, so [`encode`] rejects remote frames.

use crate::{Frame, Id, crc};

const MAGIC: u16 = 0x2934;
const FLAG_FD: u16 = 1 << 0;
const EXTENDED: u32 = 1 << 31;
const EXTENDED_ID_MAX: u32 = 0x1FFF_FFFF;
const STANDARD_ID_MAX: u32 = 0x7FF;
const DATA_MAX: usize = 8;

const MAGIC_AT: usize = 0;
const CRC_AT: usize = 2;
const FLAGS_AT: usize = 4;
const ID_AT: usize = 6;
const DATA_AT: usize = 10;

/// Longest datagram of the format: that of a CAN FD frame.
pub const DATAGRAM_MAX: usize = DATA_AT + 64;

/// Why a datagram is not a frame for a classic bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// Shorter than the header, or more data than a frame can have.
    Length,
    /// Not the magic number: another protocol uses this address.
    Magic,
    Crc,
    /// A CAN FD frame.
    Fd,
    /// Neither 11 nor 29 bits.
    Id,
}

/// The datagram for a frame; `None` for a remote frame.
pub fn encode(frame: &Frame) -> Option<Vec<u8>> {
    if frame.remote {
        return None;
    }
    let id = match frame.id {
        Id::Standard(id) => u32::from(id),
        Id::Extended(id) => id | EXTENDED,
    };
    let mut datagram = vec![0; DATA_AT];
    datagram[MAGIC_AT..CRC_AT].copy_from_slice(&MAGIC.to_le_bytes());
    datagram[ID_AT..DATA_AT].copy_from_slice(&id.to_le_bytes());
    datagram.extend_from_slice(frame.data());
    let crc = crc::feed(crc::INITIAL, &datagram[FLAGS_AT..]);
    datagram[CRC_AT..FLAGS_AT].copy_from_slice(&crc.to_le_bytes());
    Some(datagram)
}

/// The frame in a datagram.
pub fn decode(datagram: &[u8]) -> Result<Frame, Refused> {
    let (header, data) = datagram.split_first_chunk::<DATA_AT>().ok_or(Refused::Length)?;
    let u16_at = |at: usize| u16::from_le_bytes([header[at], header[at + 1]]);
    if u16_at(MAGIC_AT) != MAGIC {
        return Err(Refused::Magic);
    }
    if u16_at(CRC_AT) != crc::feed(crc::INITIAL, &datagram[FLAGS_AT..]) {
        return Err(Refused::Crc);
    }
    if u16_at(FLAGS_AT) & FLAG_FD != 0 {
        return Err(Refused::Fd);
    }
    if data.len() > DATA_MAX {
        return Err(Refused::Length);
    }
    let field = u32::from_le_bytes([
        header[ID_AT],
        header[ID_AT + 1],
        header[ID_AT + 2],
        header[ID_AT + 3],
    ]);
    let id = field & !EXTENDED;
    match field & EXTENDED != 0 {
        true if id <= EXTENDED_ID_MAX => Ok(Frame::extended(id, data)),
        false if id <= STANDARD_ID_MAX => Ok(Frame::standard(id as u16, data)),
        _ => Err(Refused::Id),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Packed with pydronecan 1.0.27 for id 0x1404562A, data 01 00 A9 5C 00 C0.
    const GOLDEN: [u8; 16] = [
        0x34, 0x29, 0xF1, 0x83, 0x00, 0x00, 0x2A, 0x56, 0x04, 0x94, 0x01, 0x00, 0xA9, 0x5C, 0x00,
        0xC0,
    ];

    fn with_crc(mut datagram: Vec<u8>) -> Vec<u8> {
        let crc = crc::feed(crc::INITIAL, &datagram[4..]);
        datagram[2..4].copy_from_slice(&crc.to_le_bytes());
        datagram
    }

    #[test]
    fn an_extended_frame_has_the_bytes_of_pydronecan() {
        let frame = Frame::extended(0x1404_562A, &[0x01, 0x00, 0xA9, 0x5C, 0x00, 0xC0]);
        assert_eq!(encode(&frame).unwrap(), GOLDEN);
        assert_eq!(decode(&GOLDEN), Ok(frame));
    }

    #[test]
    fn frames_of_every_length_and_both_widths_survive_a_round_trip() {
        for len in 0..=8 {
            let data = [0xA5; 8];
            for frame in
                [Frame::standard(0x7FF, &data[..len]), Frame::extended(0x1FFF_FFFF, &data[..len])]
            {
                assert_eq!(decode(&encode(&frame).unwrap()), Ok(frame));
            }
        }
    }

    #[test]
    fn a_dlc_above_eight_becomes_eight_and_a_remote_frame_is_rejected() {
        let long = Frame::with_dlc(Id::Standard(1), 15, [7; 8]);
        assert_eq!(decode(&encode(&long).unwrap()), Ok(Frame::standard(1, &[7; 8])));
        assert_eq!(encode(&Frame::remote(Id::Extended(1), 0)), None);
    }

    #[test]
    fn other_datagrams_are_rejected_with_the_reason() {
        for len in 0..10 {
            assert_eq!(decode(&GOLDEN[..len]), Err(Refused::Length));
        }
        let mut bytes = GOLDEN.to_vec();
        bytes[0] ^= 1;
        assert_eq!(decode(&bytes), Err(Refused::Magic));
        for at in 2..GOLDEN.len() {
            let mut bytes = GOLDEN.to_vec();
            bytes[at] ^= 1;
            assert_eq!(decode(&bytes), Err(Refused::Crc), "byte {at}");
        }
        let mut fd = GOLDEN.to_vec();
        fd[4] = 1;
        assert_eq!(decode(&with_crc(fd)), Err(Refused::Fd));
        let mut long = GOLDEN.to_vec();
        long.extend([0; 3]);
        assert_eq!(decode(&with_crc(long)), Err(Refused::Length));
    }

    /// Bits 29 and 30 mark error and remote frames in other programs' identifiers. The last
    /// identifier lacks bit 31.
    #[test]
    fn identifiers_with_unknown_flags_are_rejected() {
        for top in [0xB4, 0xD4, 0x14] {
            let mut bytes = GOLDEN.to_vec();
            bytes[9] = top;
            assert_eq!(decode(&with_crc(bytes)), Err(Refused::Id), "{top:X}");
        }
    }
}
