//! The values of the parameters that are in force.

use super::descriptions::{
    DEFAULTS, Descriptions, MINIMA, NAMES, NAMES_OF_OUTPUT, VALUE_LEN, is_in_range, place, sign,
};
use super::{At, COUNT, HAS_PREFIX, NONE, OutputParameter, Parameter, ROWS, SINGLE, TEMPLATE};
use crate::hardware::OUTPUTS;
use crate::progmem::Progmem;
use crate::tables::bit_rate::{HIGHEST_RATE, LOWEST, in_bits_per_second};

/// The values in force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameters {
    pub(super) values: [[u8; VALUE_LEN as usize]; COUNT],
}

impl Parameters {
    /// All values zero, until they are loaded.
    pub const fn new() -> Self {
        Self { values: [[0; VALUE_LEN as usize]; COUNT] }
    }

    /// The value of a parameter, in two's complement if its minimum is negative.
    pub fn get(&self, parameter: Parameter) -> u16 {
        if parameter.0 == NONE {
            return 0;
        }
        u16::from_le_bytes(self.values[usize::from(parameter.0)])
    }

    /// The value of a parameter; `fixed` if the build leaves it out.
    pub fn get_or(&self, parameter: Parameter, fixed: u16) -> u16 {
        if parameter.0 == NONE { fixed } else { self.get(parameter) }
    }

    /// The value of a parameter of an output.
    #[inline(never)]
    pub fn of(&self, output: usize, parameter: OutputParameter) -> u16 {
        let index = usize::from(parameter.index(output));
        u16::from_le_bytes(self.values.get(index).copied().unwrap_or_default())
    }

    /// True if a parameter is not zero. For parameters below 256 only.
    pub fn is_on(&self, parameter: Parameter) -> bool {
        parameter.0 != NONE && self.values[usize::from(parameter.0)][0] != 0
    }

    /// The values for the store, two bytes each.
    pub(crate) fn bytes(&mut self) -> &mut [u8] {
        self.values.as_flattened_mut()
    }

    /// The index of the parameter with this name; [`NONE`] if no parameter has it.
    pub fn find(name: &[u8], flash: impl Progmem<Descriptions>) -> u8 {
        let (mut name, mut output) = (name, 0);
        let (mut rows, mut at) = (0..ROWS as u8, NAMES);
        if HAS_PREFIX {
            rows.end = SINGLE.len() as u8;
        }
        if HAS_PREFIX
            && let [b'O', b'U', b'T', digit, b'_', rest @ ..] = name
            && digit.wrapping_sub(b'1') < OUTPUTS as u8
        {
            (name, output) = (rest, digit - b'0');
            (rows, at) = (SINGLE.len() as u8..ROWS as u8, NAMES_OF_OUTPUT);
        }
        for row in rows {
            let len = flash.byte(at);
            at = at.wrapping_add(1);
            let mut byte_at = at;
            if usize::from(len) == name.len()
                && name.iter().all(|&byte| {
                    let expected = flash.byte(byte_at);
                    byte_at = byte_at.wrapping_add(1);
                    byte == expected
                })
            {
                return (1..output).fold(row, |index, _| index + TEMPLATE.len() as u8);
            }
            at = at.wrapping_add(u16::from(len));
        }
        NONE
    }

    /// Sets a parameter to a number. Returns false, and changes nothing, if the index does not
    /// exist or the number is out of range.
    pub fn set(&mut self, index: u8, mut number: i32, flash: impl Progmem<Descriptions>) -> bool {
        if usize::from(index) >= COUNT {
            return false;
        }
        if index == Parameter::CanBaudrate.index() {
            let mut baudrate = 0;
            while baudrate <= HIGHEST_RATE as u8 {
                if in_bits_per_second(baudrate) == number as u32 {
                    break;
                }
                baudrate += 1;
            }
            number = if LOWEST < 0 && number == 0 { LOWEST } else { i32::from(baudrate) };
        }
        let (low, high) = (number as u16, (number >> 16) as u16);
        let row = At::new(index).row;
        if !is_in_range(low, place(DEFAULTS, row), flash)
            || high != sign(low, flash.word(place(MINIMA, row)))
            || self.conflict(index, low).is_some()
        {
            return false;
        }
        self.values[usize::from(index)] = low.to_le_bytes();
        true
    }

    /// The value of the parameter with this index. `None` if the index does not exist.
    pub fn value(&self, index: u8) -> Option<u16> {
        self.values.get(usize::from(index)).map(|&value| u16::from_le_bytes(value))
    }

    /// Sets parameters to their defaults: those with a value out of its range, and if `all`, all.
    /// Returns true if it set one.
    fn reset(&mut self, all: bool, flash: impl Progmem<Descriptions>) -> bool {
        let mut at = At { row: 0, output: 0 };
        let mut has_reset = false;
        for value in &mut self.values {
            if HAS_PREFIX && (at.row == SINGLE.len() as u8 || at.row == ROWS as u8) {
                at = At { row: SINGLE.len() as u8, output: at.output + 1 };
            }
            let default_at = place(DEFAULTS, at.row);
            if all || !is_in_range(u16::from_le_bytes(*value), default_at, flash) {
                *value = flash.word(default_at).wrapping_add(at.above_default()).to_le_bytes();
                has_reset = true;
            }
            at.row += 1;
        }
        has_reset
    }

    /// Sets the parameters with values out of range to their defaults. Returns true if there are
    /// any.
    pub fn repair(&mut self, flash: impl Progmem<Descriptions>) -> bool {
        self.reset(false, flash)
    }

    /// Sets all parameters to their defaults.
    pub fn set_defaults(&mut self, flash: impl Progmem<Descriptions>) {
        self.reset(true, flash);
    }
}
