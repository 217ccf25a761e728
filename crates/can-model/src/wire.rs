//! A frame as the sequence of levels on the wire: fields, CRC-15 and stuff bits.
//!
//! ```text
//! standard: SOF ID[28:18] RTR IDE=d r0 DLC[3:0] data CRC[14:0] |
//!           CRCdel ACK ACKdel EOF*7 | 3 x intermission
//! extended: SOF ID[28:18] SRR=r IDE=r ID[17:0] RTR r1 r0 DLC[3:0] data CRC[14:0] |
//!           (the same)
//!           '------------------------ stuffed --------------------------------'
//! ```
//! d = dominant = 0, r = recessive = 1. In the stuffed part, after five equal bits (including stuff
//! bits) one bit of the other level follows, also after the last CRC bit.
//!
//! Source: Bosch CAN 2.0B, "Frame formats", "Bit stream coding"; ISO 11898-1:2003 10.4, 10.5.

use super::{Frame, Id};
use std::ops::{BitAnd, BitAndAssign, Not};

/// Level of the wire during one bit.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Hash)]
#[repr(u8)]
pub enum Level {
    /// Driven; logical 0; overrides recessive.
    Dominant = 0,
    /// Released; logical 1; the level of an idle wire.
    Recessive = 1,
}

impl Level {
    /// The level of a logical bit: 1 is recessive.
    pub const fn from_bit(bit: bool) -> Level {
        if bit { Level::Recessive } else { Level::Dominant }
    }

    /// True if a station drives the wire.
    pub const fn is_dominant(self) -> bool {
        matches!(self, Level::Dominant)
    }
}

impl BitAnd for Level {
    type Output = Level;
    /// The level of a wire that both sides drive: dominant wins.
    fn bitand(self, other: Level) -> Level {
        Level::from_bit(self as u8 & other as u8 != 0)
    }
}

impl BitAndAssign for Level {
    fn bitand_assign(&mut self, other: Level) {
        *self = *self & other;
    }
}

impl Not for Level {
    type Output = Level;
    fn not(self) -> Level {
        match self {
            Level::Dominant => Level::Recessive,
            Level::Recessive => Level::Dominant,
        }
    }
}

/// Number of equal bits after which a stuff bit follows.
pub(super) const STUFF_AFTER: u8 = 5;
/// Number of bits of the intermission between frames.
pub(super) const INTERMISSION_BITS: u8 = 3;
/// Number of bits of the end of frame.
pub(super) const EOF_BITS: u8 = 7;
/// Number of bits of the CRC sequence.
pub(super) const CRC_BITS: u8 = 15;

/// Number of bits of CRC delimiter, ACK slot, ACK delimiter and end of frame, which are not
/// stuffed.
const TAIL_BITS: u32 = 3 + EOF_BITS as u32;
/// Number of bits of the stuffed part of a standard frame without data, before stuffing: SOF to
/// CRC.
const STANDARD_BITS: u32 = 1 + 11 + 1 + 1 + 1 + 4 + CRC_BITS as u32;
/// The same for an extended frame, which also has SRR, 18 more identifier bits and r1.
const EXTENDED_BITS: u32 = STANDARD_BITS + 1 + 18 + 1;

/// x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1, without its highest term.
const CRC_POLYNOMIAL: u16 = 0x4599;

/// The CRC-15 after one more (unstuffed) bit. It starts with 0 before the SOF.
pub(super) fn crc15(crc: u16, level: Level) -> u16 {
    // No branch, because it could not be predicted: the data is random.
    let feedback = ((crc >> 14) & 1) ^ level as u16;
    ((crc << 1) & 0x7FFF) ^ (CRC_POLYNOMIAL * feedback)
}

/// Number of bits of a frame before stuffing, SOF to end of frame.
const fn unstuffed_bits(extended: bool, len: u32) -> u32 {
    stuffed_part(extended, len) + TAIL_BITS
}

const fn stuffed_part(extended: bool, len: u32) -> u32 {
    (if extended { EXTENDED_BITS } else { STANDARD_BITS }) + 8 * len
}

/// The bits of a frame.
pub trait OnWire {
    /// The levels that a sender drives, from SOF to the end of frame. The ACK slot is recessive.
    fn wire_bits(&self) -> Vec<Level>;

    /// Exact number of bits: SOF to end of frame with stuff bits, and the intermission.
    fn bit_count(&self) -> u32;
}

impl OnWire for Frame {
    fn wire_bits(&self) -> Vec<Level> {
        let bits = WireBits::of(self);
        (0..bits.len()).map(|at| bits.get(at)).collect()
    }

    fn bit_count(&self) -> u32 {
        u32::from(WireBits::of(self).len()) + u32::from(INTERMISSION_BITS)
    }
}

/// Minimum number of bits of a data frame of `len` bytes with the intermission: no stuff bit.
pub const fn min_bits(extended: bool, len: u8) -> u32 {
    unstuffed_bits(extended, len as u32) + INTERMISSION_BITS as u32
}

/// Maximum number of bits: a stuff bit after the first five bits and after every further four.
pub const fn max_bits(extended: bool, len: u8) -> u32 {
    min_bits(extended, len) + (stuffed_part(extended, len as u32) - 1) / 4
}

const WORDS: usize = 3;
const WORD_BITS: u8 = 64;
// A frame of 8 bytes must fit.
const _: () = assert!(max_bits(true, 8) <= WORDS as u32 * WORD_BITS as u32);

/// The stuffed bits of a frame, SOF to end of frame, packed so that a sender needs no heap.
#[derive(Clone, Copy, Debug)]
pub(super) struct WireBits {
    /// Bit 0 of word 0 is the SOF. Bits beyond `len` are 1, recessive.
    words: [u64; WORDS],
    len: u8,
}

impl WireBits {
    pub fn of(frame: &Frame) -> WireBits {
        let mut writer = Writer::new();
        let remote = u32::from(frame.remote);
        writer.field(0, 1);
        match frame.id {
            Id::Standard(id) => {
                writer.field(u32::from(id), 11);
                writer.field(remote, 1);
                writer.field(0, 2);
            }
            Id::Extended(id) => {
                writer.field(id >> 18, 11);
                writer.field(0b11, 2);
                writer.field(id & 0x3_FFFF, 18);
                writer.field(remote, 1);
                writer.field(0, 2);
            }
        }
        writer.field(u32::from(frame.dlc), 4);
        for &byte in frame.data() {
            writer.field(u32::from(byte), 8);
        }
        writer.field(u32::from(writer.crc), CRC_BITS);
        let mut bits = writer.bits;
        bits.len += TAIL_BITS as u8;
        bits
    }

    pub fn len(&self) -> u8 {
        self.len
    }

    /// Number of the bits before the ACK slot.
    pub fn ack_slot(&self) -> u8 {
        self.len - EOF_BITS - 2
    }

    pub fn get(&self, at: u8) -> Level {
        Level::from_bit(self.words[usize::from(at / WORD_BITS)] >> (at % WORD_BITS) & 1 != 0)
    }

    fn push(&mut self, level: Level) {
        if level.is_dominant() {
            self.words[usize::from(self.len / WORD_BITS)] &= !(1 << (self.len % WORD_BITS));
        }
        self.len += 1;
    }
}

/// Appends fields, stuffs them, and calculates their CRC.
struct Writer {
    bits: WireBits,
    last: Level,
    run: u8,
    crc: u16,
}

impl Writer {
    fn new() -> Writer {
        let bits = WireBits { words: [u64::MAX; WORDS], len: 0 };
        Writer { bits, last: Level::Recessive, run: 0, crc: 0 }
    }

    /// The lowest `width` bits of `value`, most significant first.
    fn field(&mut self, value: u32, width: u8) {
        for shift in (0..width).rev() {
            let level = Level::from_bit(value >> shift & 1 != 0);
            self.crc = crc15(self.crc, level);
            self.push(level);
            if self.run == STUFF_AFTER {
                self.push(!level);
            }
        }
    }

    fn push(&mut self, level: Level) {
        self.run = if level == self.last { self.run + 1 } else { 1 };
        self.last = level;
        self.bits.push(level);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// CRC-15 by long division of bits, an implementation that shares no code with the one above.
    fn crc_by_long_division(message: &[u8]) -> Vec<u8> {
        const DIVISOR: [u8; 16] = [1, 1, 0, 0, 0, 1, 0, 1, 1, 0, 0, 1, 1, 0, 0, 1];
        let mut rest = message.to_vec();
        rest.extend([0; 15]);
        for at in 0..message.len() {
            if rest[at] == 1 {
                for (bit, divisor) in rest[at..].iter_mut().zip(DIVISOR) {
                    *bit ^= divisor;
                }
            }
        }
        rest.split_off(message.len())
    }

    /// Stuffs a text of bits.
    fn stuff_text(text: &str) -> String {
        let mut out = String::new();
        for bit in text.chars() {
            out.push(bit);
            if out.ends_with("00000") {
                out.push('1');
            } else if out.ends_with("11111") {
                out.push('0');
            }
        }
        out
    }

    fn as_text(levels: &[Level]) -> String {
        levels.iter().map(|level| if level.is_dominant() { '0' } else { '1' }).collect()
    }

    /// The expected text of a frame; `header` is SOF to DLC.
    fn expected(header: &str, data: &[u8]) -> String {
        let mut text: String = header.split(' ').collect();
        data.iter().for_each(|byte| text.push_str(&format!("{byte:08b}")));
        let bits: Vec<u8> = text.bytes().map(|bit| bit - b'0').collect();
        crc_by_long_division(&bits).iter().for_each(|bit| text.push_str(&bit.to_string()));
        stuff_text(&text) + "1" + "1" + "1" + "1111111"
    }

    /// SOF, identifier, RTR, IDE, r0, DLC, written by hand. A remote frame carries its DLC but no
    /// data, and a DLC above 8 means 8 bytes.
    #[test]
    fn frames_have_the_bits_of_the_specification() {
        for (text, header, data) in [
            ("123#DEAD", "0 00100100011 0 0 0 0010", &[0xDE, 0xAD][..]),
            (
                "1003F20A#01000038C7",
                "0 10000000000 1 1 111111001000001010 0 0 0 0101",
                &[0x01, 0x00, 0x00, 0x38, 0xC7],
            ),
            ("7FF#R8", "0 11111111111 1 0 0 1000", &[]),
            ("00000000#R0", "0 00000000000 1 1 000000000000000000 1 0 0 0000", &[]),
            ("000#FFFFFFFFFFFFFFFF_F", "0 00000000000 0 0 0 1111", &[0xFF; 8]),
        ] {
            let frame: Frame = text.parse().unwrap();
            assert_eq!(as_text(&frame.wire_bits()), expected(header, data), "{text}");
        }
    }

    #[test]
    fn an_extended_frame_takes_67_bits_and_8_per_byte_before_stuffing() {
        for len in 0..=8 {
            assert_eq!(min_bits(true, len), 67 + 8 * u32::from(len));
            assert_eq!(min_bits(false, len), 47 + 8 * u32::from(len));
        }
        assert_eq!(max_bits(true, 8), 160);
        assert_eq!(max_bits(false, 8), 135);
    }
}
