//! Parses a frame bit by bit: removes stuff bits, follows the fields, checks the CRC and
//! the fixed bits. It does not know whether its node is receiving or sending.
//!
//! Reserved bits and SRR are accepted at either level. A DLC above eight means eight bytes.
//!
//! Source: ISO 11898-1:2003 10.4 (formats), 10.5 (stuffing), 10.9 (validity); Bosch CAN 2.0B.

use super::wire::{CRC_BITS, EOF_BITS, Level, STUFF_AFTER, crc15};
use super::{Frame, Id};

/// The field that the next (unstuffed) bit belongs to, in the order of the wire.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum Field {
    Sof,
    BaseId,
    /// RTR of a standard frame or SRR of an extended one; IDE shows which.
    RtrOrSrr,
    Ide,
    ExtendedId,
    ExtendedRtr,
    Reserved1,
    Reserved0,
    Dlc,
    Data,
    Crc,
    CrcDelimiter,
    AckSlot,
    AckDelimiter,
    EndOfFrame,
}

/// The result of a bit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Step {
    /// No result yet.
    More,
    /// The ACK slot has ended and the CRC is valid.
    Acknowledged,
    /// Last but one end-of-frame bit: the frame is valid for a receiver.
    Valid,
    /// Last end-of-frame bit, recessive as required.
    End,
    /// Last end-of-frame bit, dominant.
    EndDominant,
    /// Six equal bits.
    StuffError,
    /// The CRC was wrong; reported after the ACK delimiter, when the error flag is due.
    CrcError,
    /// A fixed bit was dominant.
    FormError,
}

/// A frame in progress.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Parser {
    field: Field,
    /// Number of bits that are missing in `field`.
    left: u8,
    /// Number of consecutive equal bits, including stuff bits.
    run: u8,
    last: Level,
    /// Value of the received bits of `field`; in `Data` of the current byte.
    value: u32,
    crc: u16,
    crc_is_right: bool,
    id: u32,
    extended: bool,
    remote: bool,
    dlc: u8,
    data: [u8; 8],
    data_len: u8,
    data_at: u8,
}

impl Parser {
    /// A parser that waits for a SOF.
    pub fn new() -> Parser {
        Parser {
            field: Field::Sof,
            left: 1,
            run: 0,
            last: Level::Recessive,
            value: 0,
            crc: 0,
            crc_is_right: false,
            id: 0,
            extended: false,
            remote: false,
            dlc: 0,
            data: [0; 8],
            data_len: 0,
            data_at: 0,
        }
    }

    pub fn field(&self) -> Field {
        self.field
    }

    /// True if the next bit is the first of the field after arbitration, in either format.
    pub fn is_past_arbitration(&self) -> bool {
        self.field == Field::Dlc && self.left == 4
    }

    /// True if the next bit is a stuff bit.
    pub fn expects_stuff_bit(&self) -> bool {
        self.run == STUFF_AFTER
    }

    /// True if the next bit is one in which a sender of this format can lose arbitration.
    pub fn is_arbitrating(&self, extended: bool) -> bool {
        let last = if extended { Field::ExtendedRtr } else { Field::RtrOrSrr };
        (Field::BaseId..=last).contains(&self.field)
    }

    /// True if the next bit is the ACK slot of a frame with a valid CRC.
    pub fn wants_acknowledgement(&self) -> bool {
        self.field == Field::AckSlot && self.crc_is_right
    }

    /// Handles one bit.
    pub fn push(&mut self, level: Level) -> Step {
        if self.expects_stuff_bit() {
            if level == self.last {
                return Step::StuffError;
            }
            self.last = level;
            self.run = 1;
            return Step::More;
        }
        if self.field > Field::Crc {
            return self.push_fixed(level);
        }
        self.run = if level == self.last { self.run + 1 } else { 1 };
        self.last = level;
        if self.field != Field::Crc {
            self.crc = crc15(self.crc, level);
        }
        self.value = self.value << 1 | level as u32;
        self.left -= 1;
        if self.left == 0 {
            self.end_field();
        }
        Step::More
    }

    fn end_field(&mut self) {
        let value = self.value;
        self.value = 0;
        let bit = value & 1 != 0;
        match self.field {
            Field::Sof => self.enter(Field::BaseId, 11),
            Field::BaseId => {
                self.id = value;
                self.enter(Field::RtrOrSrr, 1);
            }
            Field::RtrOrSrr => {
                self.remote = bit;
                self.enter(Field::Ide, 1);
            }
            Field::Ide if bit => {
                self.extended = true;
                self.enter(Field::ExtendedId, 18);
            }
            Field::Ide => self.enter(Field::Reserved0, 1),
            Field::ExtendedId => {
                self.id = self.id << 18 | value;
                self.enter(Field::ExtendedRtr, 1);
            }
            Field::ExtendedRtr => {
                self.remote = bit;
                self.enter(Field::Reserved1, 1);
            }
            Field::Reserved1 => self.enter(Field::Reserved0, 1),
            Field::Reserved0 => self.enter(Field::Dlc, 4),
            Field::Dlc => {
                self.dlc = value as u8;
                self.data_len = if self.remote { 0 } else { self.dlc.min(8) };
                self.enter_data_or_crc();
            }
            Field::Data => {
                self.data[usize::from(self.data_at)] = value as u8;
                self.data_at += 1;
                self.enter_data_or_crc();
            }
            Field::Crc => {
                self.crc_is_right = value == u32::from(self.crc);
                self.enter(Field::CrcDelimiter, 1);
            }
            _ => unreachable!("{:?} is not stuffed", self.field),
        }
    }

    fn enter(&mut self, field: Field, bits: u8) {
        self.field = field;
        self.left = bits;
    }

    fn enter_data_or_crc(&mut self) {
        if self.data_at < self.data_len {
            self.enter(Field::Data, 8);
        } else {
            self.enter(Field::Crc, CRC_BITS);
        }
    }

    fn push_fixed(&mut self, level: Level) -> Step {
        match self.field {
            Field::CrcDelimiter => {
                // From here on no stuff bit is possible.
                self.run = 0;
                self.enter(Field::AckSlot, 1);
                if level.is_dominant() { Step::FormError } else { Step::More }
            }
            Field::AckSlot => {
                self.enter(Field::AckDelimiter, 1);
                if self.crc_is_right { Step::Acknowledged } else { Step::More }
            }
            Field::AckDelimiter => {
                self.enter(Field::EndOfFrame, EOF_BITS);
                if !self.crc_is_right {
                    Step::CrcError
                } else if level.is_dominant() {
                    Step::FormError
                } else {
                    Step::More
                }
            }
            _ => {
                self.left -= 1;
                match (self.left, level) {
                    (0, Level::Dominant) => Step::EndDominant,
                    (0, Level::Recessive) => Step::End,
                    (_, Level::Dominant) => Step::FormError,
                    (1, Level::Recessive) => Step::Valid,
                    (_, Level::Recessive) => Step::More,
                }
            }
        }
    }

    /// True if the identifier and the control field have arrived.
    pub fn has_control_field(&self) -> bool {
        self.field > Field::Dlc
    }

    /// The frame, after [`Step::Valid`]. Before that, data that have not arrived are zero.
    pub fn frame(&self) -> Frame {
        let id = if self.extended { Id::Extended(self.id) } else { Id::Standard(self.id as u16) };
        if self.remote {
            Frame::remote(id, self.dlc)
        } else {
            Frame::with_dlc(id, self.dlc, self.data)
        }
    }
}
