//! The text protocol of SLCAN adapters: commands to the adapter, frames from it.
//!
//! A command is a letter, its arguments, and a carriage return:
//!
//! | Command | Meaning                             | Command     | Meaning                                 |
//! | ------- | ----------------------------------- | ----------- | --------------------------------------- |
//! | `S0..8` | bit rate                            | `tiiildd..` | data frame, 11-bit identifier           |
//! | `O` `L` | open, open to listen only           | `T` + 8 hex | data frame, 29-bit identifier           |
//! | `C`     | close                               | `r` `R`     | the same as remote frames, without data |
//! | `F`     | flags                               | `V` `N`     | version, serial number                  |
//! | `Z0` `Z1` | time stamps off, on               | `M` `m` `W` | acceptance filter: only "everything"    |
//!
//! Hexadecimal digits may have either case, and are sent in upper case. Line feeds are ignored; an
//! empty line is a command without effect. Commands that are not in the table (`s`, `Q`, `X0`, CAN
//! FD) are rejected.
//!
//! Source: Lawicel AB, "CAN232 manual" and "CANUSB manual", section "Available commands", and
//! recordings of pydronecan and python-can.

pub mod adapter;

use crate::{Frame, Id};

/// Longest command: `T`, identifier, length, eight bytes.
const LINE_MAX: usize = 1 + 8 + 1 + 16;

/// A command of a client.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    Nothing,
    BitRate(u32),
    Open,
    Listen,
    Close,
    Send(Frame),
    Flags,
    Version,
    SerialNumber,
    Timestamps(bool),
    /// A filter that passes everything, the only one that exists.
    AcceptAll,
}

/// Splits the input into commands.
#[derive(Debug, Default)]
pub struct Lines {
    line: Vec<u8>,
    too_long: bool,
}

impl Lines {
    /// Handles a byte. At the end of a line returns the command in it, or `Err` if it is invalid.
    pub fn push(&mut self, byte: u8) -> Option<Result<Command, ()>> {
        match byte {
            b'\n' => None,
            b'\r' => {
                let too_long = std::mem::take(&mut self.too_long);
                let command = if too_long { None } else { parse(&self.line) };
                self.line.clear();
                Some(command.ok_or(()))
            }
            _ if self.line.len() == LINE_MAX => {
                self.too_long = true;
                None
            }
            _ => {
                self.line.push(byte);
                None
            }
        }
    }
}

fn parse(line: &[u8]) -> Option<Command> {
    let Some((&letter, rest)) = line.split_first() else {
        return Some(Command::Nothing);
    };
    match (letter, rest) {
        (b'S', [digit]) => Some(Command::BitRate(bit_rate(*digit)?)),
        (b'O', []) => Some(Command::Open),
        (b'L', []) => Some(Command::Listen),
        (b'C', []) => Some(Command::Close),
        (b'F', []) => Some(Command::Flags),
        (b'V', []) => Some(Command::Version),
        (b'N', []) => Some(Command::SerialNumber),
        (b'Z', [digit @ (b'0' | b'1')]) => Some(Command::Timestamps(*digit == b'1')),
        // Acceptance code and mask of the SJA1000. A 1 in the mask means "does not matter".
        (b'M', [_, ..]) if rest.len() == 8 && hex(rest)? == 0 => Some(Command::AcceptAll),
        (b'm', [_, ..]) if rest.len() == 8 && hex(rest)? == u32::MAX => Some(Command::AcceptAll),
        (b'W', [b'0' | b'1']) => Some(Command::AcceptAll),
        (b't' | b'r', _) => frame(rest, 3, letter == b'r').map(Command::Send),
        (b'T' | b'R', _) => frame(rest, 8, letter == b'R').map(Command::Send),
        _ => None,
    }
}

/// The bit rate of each digit, in thousands.
const KBIT_S: [u32; 9] = [10, 20, 50, 100, 125, 250, 500, 800, 1000];

fn bit_rate(digit: u8) -> Option<u32> {
    let kbit_s = KBIT_S.get(usize::from(digit.checked_sub(b'0')?))?;
    Some(kbit_s * 1000)
}

fn frame(text: &[u8], id_digits: usize, remote: bool) -> Option<Frame> {
    let (id, rest) = text.split_at_checked(id_digits)?;
    let (length, data) = rest.split_first()?;
    let id = hex(id)?;
    let id = match id_digits {
        3 if id <= 0x7FF => Id::Standard(id as u16),
        8 if id <= 0x1FFF_FFFF => Id::Extended(id),
        _ => return None,
    };
    let length = hex(&[*length]).filter(|length| *length <= 8)? as u8;
    if remote {
        return data.is_empty().then(|| Frame::remote(id, length));
    }
    if data.len() != 2 * usize::from(length) {
        return None;
    }
    let mut bytes = [0; 8];
    for (byte, digits) in bytes.iter_mut().zip(data.chunks(2)) {
        *byte = hex(digits)? as u8;
    }
    Some(Frame::with_dlc(id, length, bytes))
}

fn hex(digits: &[u8]) -> Option<u32> {
    digits.iter().try_fold(0, |value, digit| Some(value << 4 | char::from(*digit).to_digit(16)?))
}

/// A reply of an adapter to its client.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reply {
    /// The adapter executed a command or accepted a frame.
    Done,
    /// The adapter rejected a command (BEL).
    Refused,
    Received(Frame),
    /// The flags of an answer to `F`.
    Flags(u8),
    /// An answer to `V` or `N`.
    Other,
    /// A line that this protocol does not have.
    Invalid,
}

const BEL: u8 = 0x07;

/// Splits an adapter's output into replies.
#[derive(Debug, Default)]
pub struct Replies {
    line: Vec<u8>,
    /// The time stamp of the last frame in microseconds, if it had one.
    pub stamp_us: Option<u64>,
}

/// Digits of a time stamp, and its unit in microseconds: milliseconds in the CAN232's protocol,
/// microseconds in others.
const STAMPS: [(usize, u64); 2] = [(4, 1000), (8, 1)];
/// Longest reply: a frame with its time stamp.
const REPLY_MAX: usize = LINE_MAX + 8;

impl Replies {
    /// Handles a byte. At the end of a reply returns it.
    pub fn push(&mut self, byte: u8) -> Option<Reply> {
        match byte {
            b'\n' => None,
            BEL => {
                self.line.clear();
                Some(Reply::Refused)
            }
            b'\r' => {
                let (reply, stamp_us) = reply(&self.line);
                self.line.clear();
                if matches!(reply, Reply::Received(_)) {
                    self.stamp_us = stamp_us;
                }
                Some(reply)
            }
            _ => {
                // A reply that is too long is invalid.
                if self.line.len() <= REPLY_MAX {
                    self.line.push(byte);
                }
                None
            }
        }
    }
}

/// A reply, and the time stamp of a frame.
fn reply(line: &[u8]) -> (Reply, Option<u64>) {
    let (letter, rest) = match line {
        [] | [b'z' | b'Z'] => return (Reply::Done, None),
        [letter, rest @ ..] => (*letter, rest),
    };
    let id_digits = match letter {
        b't' | b'r' => 3,
        b'T' | b'R' => 8,
        b'F' if let Some(flags) = hex(rest) => return (Reply::Flags(flags as u8), None),
        b'V' | b'v' | b'N' | b'F' => return (Reply::Other, None),
        _ => return (Reply::Invalid, None),
    };
    let remote = matches!(letter, b'r' | b'R');
    if let Some(frame) = frame(rest, id_digits, remote) {
        return (Reply::Received(frame), None);
    }
    // Adapters add time stamps on request; some always do.
    let stamped = |(digits, unit): (usize, u64)| {
        let (line, stamp) = rest.split_at_checked(rest.len().checked_sub(digits)?)?;
        let stamp_us = u64::from(hex(stamp)?) * unit;
        Some((Reply::Received(frame(line, id_digits, remote)?), Some(stamp_us)))
    };
    STAMPS.into_iter().find_map(stamped).unwrap_or((Reply::Invalid, None))
}

/// The digit of the command `S` for a bit rate, if it has one.
pub fn rate_digit(bit_rate: u32) -> Option<char> {
    ('0'..='8').find(|digit| self::bit_rate(*digit as u8) == Some(bit_rate))
}

/// A frame in the form for the client, with the time in milliseconds of the minute if there is one.
pub fn line(frame: &Frame, timestamp_ms: Option<u16>) -> Vec<u8> {
    let mut text = match (frame.id, frame.remote) {
        (Id::Standard(id), false) => format!("t{id:03X}"),
        (Id::Standard(id), true) => format!("r{id:03X}"),
        (Id::Extended(id), false) => format!("T{id:08X}"),
        (Id::Extended(id), true) => format!("R{id:08X}"),
    };
    // The protocol has no DLC above 8; those mean eight bytes, too.
    text += &frame.dlc.min(8).to_string();
    for byte in frame.data() {
        text += &format!("{byte:02X}");
    }
    if let Some(timestamp_ms) = timestamp_ms {
        text += &format!("{timestamp_ms:04X}");
    }
    text.push('\r');
    text.into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn commands(bytes: &[u8]) -> Vec<Result<Command, ()>> {
        let mut lines = Lines::default();
        bytes.iter().filter_map(|byte| lines.push(*byte)).collect()
    }

    /// As pydronecan and python-can send them; in both cases of hexadecimal digits, and with line
    /// feeds.
    #[test]
    fn commands_are_parsed() {
        let frame = Frame::extended(0x1404_562A, &[0x01, 0x00, 0xA9, 0x5C, 0x00, 0xC0]);
        let letters = Command::Send(Frame::extended(0x1ABC_DEF0, &[0xAB]));
        for (line, command) in [
            (&b"\r"[..], Command::Nothing),
            (b"C\r", Command::Close),
            (b"S8\r", Command::BitRate(1_000_000)),
            (b"O\r", Command::Open),
            (b"F\r", Command::Flags),
            (b"V\r", Command::Version),
            (b"N\r", Command::SerialNumber),
            (b"T1404562A60100a95c00c0\r", Command::Send(frame)),
            (b"t1233010203\r", Command::Send(Frame::standard(0x123, &[1, 2, 3]))),
            (b"r1233\r", Command::Send(Frame::remote(Id::Standard(0x123), 3))),
            (b"T1ABCDEF01AB\r\n", letters),
            (b"\nT1abcdef01ab\r\n", letters),
        ] {
            assert_eq!(commands(line), [Ok(command)], "{}", line.escape_ascii());
        }
    }

    #[test]
    fn an_invalid_command_is_an_error() {
        let wrong = b"S9 S S88 s0014 OO o X0 ? \x07 \xFF\x00 t800100 T2000000000 t12 t1239 t1231 \
            t123101FF t1231G0 t+231FF T1404562A8 r123300 M00000001 m00000000 d12380011223344556677";
        for text in wrong.split(|byte| *byte == b' ') {
            let line = [text, b"\r"].concat();
            assert_eq!(commands(&line), [Err(())], "{}", text.escape_ascii());
        }
    }

    #[test]
    fn a_line_that_is_too_long_is_one_error() {
        let mut bytes = vec![b'T'; 100_000];
        bytes.extend(b"\rO\r");
        assert_eq!(commands(&bytes), [Err(()), Ok(Command::Open)]);
    }

    #[test]
    fn frames_survive_a_round_trip() {
        let frames = [
            Frame::extended(0x1FFF_FFFF, &[1, 2, 3, 4, 5, 6, 7, 0xFF]),
            Frame::standard(0, &[]),
            Frame::remote(Id::Extended(1), 8),
            Frame::remote(Id::Standard(0x7FF), 0),
        ];
        for frame in frames {
            assert_eq!(commands(&line(&frame, None)), [Ok(Command::Send(frame))]);
        }
    }

    fn replies(bytes: &[u8]) -> Vec<Reply> {
        let mut replies = Replies::default();
        bytes.iter().filter_map(|byte| replies.push(*byte)).collect()
    }

    #[test]
    fn replies_of_an_adapter_are_parsed() {
        let frame = Frame::extended(0x1404_562A, &[0x01, 0x00, 0xA9, 0x5C, 0x00, 0xC0]);
        let stamped = line(&frame, Some(59_999));
        let bytes =
            [b"\r\x07Z\rz\rV1013\r".to_vec(), line(&frame, None), stamped, b"t12\r".to_vec()]
                .concat();
        let (done, other, received) = (Reply::Done, Reply::Other, Reply::Received(frame));
        assert_eq!(
            replies(&bytes),
            [done, Reply::Refused, done, done, other, received, received, Reply::Invalid]
        );
    }

    /// Four or eight more digits are a time stamp, but only after as much data as the length says.
    #[test]
    fn a_time_stamp_is_distinguished_from_data() {
        let remote = Frame::remote(Id::Standard(0x123), 4);
        assert_eq!(replies(b"r1234\rr1234ABCD\r"), [Reply::Received(remote); 2]);
        let data = Frame::standard(0x123, &[0xAB]);
        assert_eq!(replies(b"t1231ABCDEF\r"), [Reply::Received(data)]);
        assert_eq!(replies(b"t1231AB0123ABCD\r"), [Reply::Received(data)]);
        assert_eq!(replies(b"r12340123ABCD\r"), [Reply::Received(remote)]);
        let wrong = b"t1231AB12\rt1231AB123G\rt1231AB123456\rt1231AB1234567G\r";
        assert_eq!(replies(wrong), [Reply::Invalid; 4]);
    }

    #[test]
    fn a_reply_that_is_too_long_is_one_invalid_reply() {
        let mut bytes = vec![b'T'; 100_000];
        bytes.extend(b"\rZ\r");
        assert_eq!(replies(&bytes), [Reply::Invalid, Reply::Done]);
    }

    #[test]
    fn a_timestamp_follows_the_data() {
        assert_eq!(line(&Frame::standard(0x123, &[0xAB]), Some(59_999)), b"t1231ABEA5F\r");
    }

    #[test]
    fn a_dlc_above_eight_is_sent_as_eight() {
        let frame = Frame::with_dlc(Id::Standard(1), 15, [0; 8]);
        assert_eq!(line(&frame, None), b"t00180000000000000000\r");
    }
}
