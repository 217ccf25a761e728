#![doc = include_str!("../README.md")]
//! # Text
//!
//! The text form is candump's: `1003F20A#01000038C7` (extended, eight digits), `123#R4` (standard,
//! remote, DLC 4; no digit for 0), and `123#1122334455667788_C` for a DLC above eight (here 12).

#![forbid(unsafe_code)]

use std::fmt;
use std::str::FromStr;

/// Maximum number of data bytes in a frame.
const MAX_DATA: usize = 8;
/// The DLC is four bits on the wire; 9 to 15 mean eight bytes.
const MAX_DLC: u8 = 15;
const STANDARD_ID_MAX: u16 = 0x7FF;
const EXTENDED_ID_MAX: u32 = 0x1FFF_FFFF;

/// Identifier of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Hash)]
pub enum Id {
    /// 11 bits.
    Standard(u16),
    /// 29 bits.
    Extended(u32),
}

impl Id {
    /// True if the value fits in its width.
    const fn is_in_range(self) -> bool {
        match self {
            Id::Standard(id) => id <= STANDARD_ID_MAX,
            Id::Extended(id) => id <= EXTENDED_ID_MAX,
        }
    }
}

/// One data or remote frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Hash)]
pub struct Frame {
    /// Identifier.
    pub id: Id,
    /// True for a remote frame, which requests data and has none.
    pub remote: bool,
    /// DLC as on the wire, 0 to 15.
    pub dlc: u8,
    /// Bytes beyond the frame's length are 0, so that equal frames compare as equal.
    data: [u8; MAX_DATA],
}

impl Frame {
    /// A data frame with a 29-bit identifier. Panics if the identifier or the data is too long.
    pub fn extended(id: u32, data: &[u8]) -> Frame {
        Frame::of_slice(Id::Extended(id), data)
    }

    /// A data frame with an 11-bit identifier. Panics if the identifier or the data is too long.
    pub fn standard(id: u16, data: &[u8]) -> Frame {
        Frame::of_slice(Id::Standard(id), data)
    }

    /// A remote frame. Panics if the identifier or the DLC does not fit.
    pub fn remote(id: Id, dlc: u8) -> Frame {
        Frame { remote: true, ..Frame::with_dlc(id, dlc, [0; MAX_DATA]) }
    }

    /// A data frame with this DLC. Bytes beyond the length are dropped. Panics if the
    /// identifier or the DLC does not fit.
    pub fn with_dlc(id: Id, dlc: u8, data: [u8; 8]) -> Frame {
        assert!(id.is_in_range(), "CAN identifier out of range: {id:X?}");
        assert!(dlc <= MAX_DLC, "a DLC has four bits, not {dlc}");
        let mut kept = [0; MAX_DATA];
        let len = usize::from(dlc).min(MAX_DATA);
        kept[..len].copy_from_slice(&data[..len]);
        Frame { id, remote: false, dlc, data: kept }
    }

    fn of_slice(id: Id, data: &[u8]) -> Frame {
        assert!(data.len() <= MAX_DATA, "a CAN frame carries 8 bytes, not {}", data.len());
        let mut bytes = [0; MAX_DATA];
        bytes[..data.len()].copy_from_slice(data);
        Frame::with_dlc(id, data.len() as u8, bytes)
    }

    /// The data; empty for a remote frame.
    pub fn data(&self) -> &[u8] {
        let len = if self.remote { 0 } else { usize::from(self.dlc).min(MAX_DATA) };
        &self.data[..len]
    }

    /// True if the identifier has 29 bits.
    pub fn is_extended(&self) -> bool {
        matches!(self.id, Id::Extended(_))
    }
}

impl fmt::Display for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.id {
            Id::Standard(id) => write!(f, "{id:03X}#")?,
            Id::Extended(id) => write!(f, "{id:08X}#")?,
        }
        if self.remote {
            f.write_str("R")?;
            if self.dlc != 0 {
                write!(f, "{:X}", self.dlc)?;
            }
            return Ok(());
        }
        for byte in self.data() {
            write!(f, "{byte:02X}")?;
        }
        if usize::from(self.dlc) > MAX_DATA {
            write!(f, "_{:X}", self.dlc)?;
        }
        Ok(())
    }
}

/// Error: the text is not a frame in candump's form.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ParseFrameError;

impl fmt::Display for ParseFrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("not a CAN frame: expected for example 1003F20A#01000038C7 or 123#R4")
    }
}

impl std::error::Error for ParseFrameError {}

impl FromStr for Frame {
    type Err = ParseFrameError;

    fn from_str(text: &str) -> Result<Frame, ParseFrameError> {
        let (id, body) = text.split_once('#').ok_or(ParseFrameError)?;
        let value = hex(id)?;
        let id = match id.len() {
            3 => Id::Standard(value as u16),
            8 => Id::Extended(value),
            _ => return Err(ParseFrameError),
        };
        if !id.is_in_range() {
            return Err(ParseFrameError);
        }
        if let Some(dlc) = body.strip_prefix('R') {
            let dlc = match dlc.len() {
                0 => 0,
                1 => hex(dlc)? as u8,
                _ => return Err(ParseFrameError),
            };
            return Ok(Frame::remote(id, dlc));
        }
        let (bytes, dlc) = match body.split_once('_') {
            Some((bytes, dlc)) => (bytes, Some(dlc)),
            None => (body, None),
        };
        let (data, len) = data_bytes(bytes)?;
        let dlc = match dlc {
            None => len,
            Some(dlc) if dlc.len() == 1 && usize::from(len) == MAX_DATA => hex(dlc)? as u8,
            Some(_) => return Err(ParseFrameError),
        };
        if dlc < len {
            return Err(ParseFrameError);
        }
        Ok(Frame::with_dlc(id, dlc, data))
    }
}

/// Accepts hexadecimal digits only; `from_str_radix` alone would accept a sign.
fn hex(text: &str) -> Result<u32, ParseFrameError> {
    if !text.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return Err(ParseFrameError);
    }
    u32::from_str_radix(text, 16).map_err(|_| ParseFrameError)
}

fn data_bytes(text: &str) -> Result<([u8; MAX_DATA], u8), ParseFrameError> {
    if !text.is_ascii() || !text.len().is_multiple_of(2) || text.len() > 2 * MAX_DATA {
        return Err(ParseFrameError);
    }
    let mut data = [0; MAX_DATA];
    for (at, byte) in data.iter_mut().enumerate().take(text.len() / 2) {
        *byte = hex(&text[2 * at..2 * at + 2])? as u8;
    }
    Ok((data, (text.len() / 2) as u8))
}

impl From<embedded_can::Id> for Id {
    fn from(id: embedded_can::Id) -> Id {
        match id {
            embedded_can::Id::Standard(id) => Id::Standard(id.as_raw()),
            embedded_can::Id::Extended(id) => Id::Extended(id.as_raw()),
        }
    }
}

impl embedded_can::Frame for Frame {
    fn new(id: impl Into<embedded_can::Id>, data: &[u8]) -> Option<Frame> {
        (data.len() <= MAX_DATA).then(|| Frame::of_slice(id.into().into(), data))
    }

    fn new_remote(id: impl Into<embedded_can::Id>, dlc: usize) -> Option<Frame> {
        (dlc <= MAX_DATA).then(|| Frame::remote(id.into().into(), dlc as u8))
    }

    fn is_extended(&self) -> bool {
        Frame::is_extended(self)
    }

    fn is_remote_frame(&self) -> bool {
        self.remote
    }

    /// Panics if `id`, which is public, is out of range.
    fn id(&self) -> embedded_can::Id {
        match self.id {
            Id::Standard(id) => embedded_can::StandardId::new(id).expect("11 bits").into(),
            Id::Extended(id) => embedded_can::ExtendedId::new(id).expect("29 bits").into(),
        }
    }

    fn dlc(&self) -> usize {
        usize::from(self.dlc)
    }

    fn data(&self) -> &[u8] {
        Frame::data(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_have_the_text_form_of_candump() {
        let command = Frame::extended(0x1003_F20A, &[0x01, 0x00, 0x00, 0x38, 0xC7]);
        assert_eq!(command.to_string(), "1003F20A#01000038C7");
        assert_eq!(Frame::standard(0x7, &[]).to_string(), "007#");
        assert_eq!(Frame::remote(Id::Standard(0x123), 0).to_string(), "123#R");
        assert_eq!(Frame::remote(Id::Extended(0x123), 4).to_string(), "00000123#R4");
        let long = Frame::with_dlc(Id::Standard(0x7FF), 12, [0x11; 8]);
        assert_eq!(long.to_string(), "7FF#1111111111111111_C");
    }

    #[test]
    fn text_survives_a_round_trip() {
        for text in
            ["1003F20A#01000038C7", "123#R", "123#RF", "00000000#", "7FF#0011223344556677_9"]
        {
            assert_eq!(text.parse::<Frame>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn text_that_is_no_frame_is_rejected() {
        for text in [
            "",
            "#",
            "123",
            "12#00",
            "800#",
            "20000000#00",
            "123#0",
            "123#0G",
            "123#+1",
            "123#R10",
            "123#001122334455667788",
            "123#00_9",
            "123#0011223344556677_7",
            "123#é0",
            "+12#00",
        ] {
            assert_eq!(text.parse::<Frame>(), Err(ParseFrameError), "{text}");
        }
    }

    #[test]
    fn bytes_beyond_the_length_are_not_compared() {
        let noisy = Frame::with_dlc(Id::Standard(1), 2, [1, 2, 0xA5, 0xA5, 0xA5, 0xA5, 0xA5, 0xA5]);
        assert_eq!(noisy, Frame::standard(1, &[1, 2]));
        assert_eq!(noisy.data(), [1, 2]);
    }

    #[test]
    fn a_remote_frame_has_a_dlc_and_no_data() {
        let frame = Frame::remote(Id::Standard(1), 8);
        assert_eq!((frame.dlc, frame.data()), (8, &[][..]));
    }

    #[test]
    fn the_embedded_can_trait_has_the_same_frame() {
        use embedded_can::Frame as _;
        let id = embedded_can::ExtendedId::new(0x1234_5678).unwrap();
        let frame = <Frame as embedded_can::Frame>::new(id, &[1, 2, 3]).unwrap();
        assert_eq!(frame, Frame::extended(0x1234_5678, &[1, 2, 3]));
        assert_eq!(frame.id(), id.into());
        assert!(<Frame as embedded_can::Frame>::new(id, &[0; 9]).is_none());
        assert!(<Frame as embedded_can::Frame>::new_remote(id, 9).is_none());
    }

    #[test]
    #[should_panic(expected = "out of range")]
    fn an_identifier_out_of_range_panics() {
        Frame::standard(0x800, &[]);
    }
}
