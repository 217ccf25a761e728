//! The table of parameters in flash, and what GetSet answers from it.

use dronecan_wire::crc;

use super::{At, COUNT, HAS_PREFIX, Parameter, ROWS, SINGLE, row};
use crate::hardware::OUTPUTS;
use crate::progmem::Progmem;
use crate::tables::bit_rate::in_bits_per_second;

/// The table in flash: [`PACKED`].
pub struct Descriptions;

/// Maximum length of a name, as in ArduPilot.
pub(super) const MAX_NAME_LEN: usize = 16;

/// Bytes of a value, in RAM and in EEPROM: little-endian, two's complement if the minimum is
/// negative.
pub(super) const VALUE_LEN: u8 = 2;

/// Values that the EEPROM of a single output has room for with two bytes of each.
const UNPACKED: usize = 45;

/// True if the EEPROM has one byte of a value whose upper byte is always zero. Where two bytes of
/// each have room, flash is scarcer.
pub(crate) const IS_PACKED: bool = OUTPUTS > 1 || COUNT > UNPACKED;

/// Bytes of the values of all parameters in EEPROM.
pub const CELLS: usize = {
    let mut cells = 0;
    let mut n = 0;
    while n < ROWS {
        let (_, min, max, _) = row(n);
        let is_byte = IS_PACKED && (min as u16 | max as u16) < 0x100;
        let times = if n < SINGLE.len() { 1 } else { OUTPUTS };
        cells += times * if is_byte { 1 } else { VALUE_LEN as usize };
        n += 1;
    }
    cells
};

/// True if the upper byte of the parameter with this index is always zero.
#[inline(always)]
pub(crate) fn is_byte(index: u8, flash: impl Progmem<Descriptions>) -> bool {
    let at = place(MAXIMA + 1, At::new(index).row);
    flash.byte(at) | flash.byte(at.wrapping_add(COLUMN_LEN)) == 0
}

/// Bytes of a column of values in flash.
const COLUMN_LEN: u16 = VALUE_LEN as u16 * ROWS as u16;

// Layout of the flash: all defaults, all maxima, all minima, then all names, each with its length
// before it.
pub(super) const DEFAULTS: u16 = 0;
pub(super) const MAXIMA: u16 = DEFAULTS + COLUMN_LEN;
pub(super) const MINIMA: u16 = MAXIMA + COLUMN_LEN;
/// Start of the names in the flash, each with its length before it.
pub const NAMES: u16 = MINIMA + COLUMN_LEN;

/// Start of the names of an output's parameters.
pub(super) const NAMES_OF_OUTPUT: u16 = end(SINGLE.len()) as u16;

const LEN: usize = end(ROWS);

/// The end of the names of the first rows.
const fn end(rows: usize) -> usize {
    let mut len = NAMES as usize;
    let mut n = 0;
    while n < rows {
        len += 1 + stored_prefix_len(n) + row(n).0.len();
        n += 1;
    }
    len
}

/// Bytes of `OUTn_` in flash before the name of a row.
const fn stored_prefix_len(n: usize) -> usize {
    if n < SINGLE.len() || HAS_PREFIX { 0 } else { PREFIX_LEN as usize }
}

/// The table. A range may begin below zero or end above 32,767. So the code compares distances from
/// the minimum, modulo 65,536.
pub const PACKED: [u8; LEN] = {
    let mut packed = [0; LEN];
    let mut at = NAMES as usize;
    let mut n = 0;
    while n < ROWS {
        let (name, min, max, default) = row(n);
        let prefix_len = if n < SINGLE.len() { 0 } else { PREFIX_LEN as usize };
        let stored_len = stored_prefix_len(n);
        assert!(!name.is_empty() && prefix_len + name.len() <= MAX_NAME_LEN);
        assert!(
            i16::MIN as i32 <= min
                && min <= default
                && default <= max
                && max - min <= u16::MAX as i32
        );
        assert!(min >= 0 || max <= i16::MAX as i32);
        let values = [default, max, min];
        let mut value = 0;
        while value < values.len() {
            let place = value * COLUMN_LEN as usize + n * VALUE_LEN as usize;
            [packed[place], packed[place + 1]] = (values[value] as u16).to_le_bytes();
            value += 1;
        }
        packed[at] = (stored_len + name.len()) as u8;
        at += 1;
        let mut c = 0;
        while c < stored_len {
            packed[at] = prefix_byte(c as u8, 1);
            at += 1;
            c += 1;
        }
        c = 0;
        while c < name.len() {
            packed[at] = name.as_bytes()[c];
            at += 1;
            c += 1;
        }
        n += 1;
    }
    packed
};

/// The version of the form in which the EEPROM has the parameters.
pub(super) const LAYOUT: u8 = 5;

/// The CRC of the layout, of the number of outputs, and of all names and ranges. That of
/// CAN_BAUDRATE begins at 0 also where it begins at -1: the values that another build has saved
/// mean the same.
pub const DIGEST: u16 = {
    let mut digest = crc::step(crc::step(0xFFFF, LAYOUT), OUTPUTS as u8);
    let mut n = 0;
    while n < ROWS {
        let (name, mut min, max, _) = row(n);
        if n == Parameter::CanBaudrate.index() as usize {
            min = 0;
        }
        let [min_low, min_high] = (min as u16).to_le_bytes();
        let [max_low, max_high] = (max as u16).to_le_bytes();
        let range = [min_low, min_high, max_low, max_high];
        let mut at = 0;
        while at < name.len() + range.len() {
            let byte = if at < name.len() { name.as_bytes()[at] } else { range[at - name.len()] };
            digest = crc::step(digest, byte);
            at += 1;
        }
        n += 1;
    }
    digest
};

/// The bits above the lower 16 of a value: its sign if the minimum is negative (then the maximum is
/// below 32,768).
pub(super) fn sign(low: u16, min: u16) -> u16 {
    ((low & min) as i16 >> 15) as u16
}

/// True if a value is in the range of the parameter whose default is at `default_at`.
#[inline(never)]
pub(super) fn is_in_range(value: u16, default_at: u16, flash: impl Progmem<Descriptions>) -> bool {
    let min = flash.word(default_at.wrapping_add(MINIMA - DEFAULTS));
    value.wrapping_sub(min)
        <= flash.word(default_at.wrapping_add(MAXIMA - DEFAULTS)).wrapping_sub(min)
}

/// The place of a parameter in a table of values.
pub(super) fn place(table: u16, index: u8) -> u16 {
    table.wrapping_add(u16::from(index.wrapping_mul(VALUE_LEN)))
}

/// Bytes of `OUTn_`.
pub const PREFIX_LEN: u8 = 5;

/// A byte of `OUTn_`, for an output counted from 1.
pub const fn prefix_byte(at: u8, output: u8) -> u8 {
    match at {
        0 => b'O',
        1 => b'U',
        2 => b'T',
        3 => b'0' + output,
        _ => b'_',
    }
}

/// Bytes of a number in a GetSet response: a tag, then eight bytes.
pub(super) const NUMBER_LEN: u8 = 9;
pub(super) const TAG_INTEGER: u8 = 1;

/// Bytes of a GetSet response before the name: value, default, maximum and minimum.
pub(super) const NUMBERS_LEN: u8 = 4 * NUMBER_LEN;

/// The GetSet response for a parameter: its bytes are made when they are sent.
#[derive(Clone, Copy)]
pub struct Response {
    at: At,
    value: u16,
    name_at: u16,
}

impl Response {
    /// Before the first response.
    pub const NONE: Self = Self { at: At { row: 0, output: 0 }, value: 0, name_at: 0 };

    /// The response for the parameter with this index, and a value of it. Returns its length, too.
    pub fn new(index: u8, value: u16, flash: impl Progmem<Descriptions>) -> (Self, u8) {
        let at = At::new(index);
        let mut name_at = NAMES + 1;
        for _ in 0..at.row {
            let len = flash.byte(name_at.wrapping_sub(1));
            name_at = name_at.wrapping_add(u16::from(len)).wrapping_add(1);
        }
        let mut len = NUMBERS_LEN + flash.byte(name_at.wrapping_sub(1));
        if HAS_PREFIX && at.output != 0 {
            len += PREFIX_LEN;
        }
        (Self { at, value, name_at }, len)
    }

    /// A byte of the response.
    pub fn byte(&self, at: u8, flash: impl Progmem<Descriptions>) -> u8 {
        match at.checked_sub(NUMBERS_LEN) {
            Some(at) => self.name_byte(at, flash),
            None => self.number_byte(at, flash),
        }
    }

    fn name_byte(&self, mut at: u8, flash: impl Progmem<Descriptions>) -> u8 {
        if HAS_PREFIX && self.at.output != 0 {
            if at < PREFIX_LEN {
                return prefix_byte(at, self.at.output);
            }
            at -= PREFIX_LEN;
        }
        flash.byte(self.name_at.wrapping_add(u16::from(at)))
    }
    fn number_byte(&self, mut at: u8, flash: impl Progmem<Descriptions>) -> u8 {
        let mut low = self.value;
        let mut number_at = place(DEFAULTS, self.at.row);
        while at >= NUMBER_LEN {
            at = at.wrapping_sub(NUMBER_LEN);
            low = flash.word(number_at);
            if number_at < MAXIMA {
                low = low.wrapping_add(self.at.above_default());
            }
            number_at = number_at.wrapping_add(COLUMN_LEN);
        }
        let mut high = sign(low, flash.word(place(MINIMA, self.at.row))) as u8;
        if self.at.row == Parameter::CanBaudrate.index() {
            let [b0, b1, b2, _] = in_bits_per_second(low as u8).to_le_bytes();
            low = u16::from_le_bytes([b0, b1]);
            high = if at == 3 { b2 } else { 0 };
        }
        match at {
            0 => TAG_INTEGER,
            1 => low as u8,
            2 => (low >> 8) as u8,
            _ => high,
        }
    }
}
