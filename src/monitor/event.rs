//! A line to log, with the values for its fields.

use super::Line;
use super::packing::Field;

/// A line to log, with the values for its fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// The text.
    pub line: Line,
    /// The values of the fields of one byte, in the order of their codes: source, transfer, code.
    pub(super) bytes: [u8; 3],
    /// `%a`: a number. `%+`: the sign of a signed number. `%0` to `%3`: its magnitude with 0 to 3
    /// decimal places.
    pub a: u16,
    /// `%b`: a number. `%p`: a number in halves. `%n`: the number of a parameter whose
    /// name to insert.
    pub b: u16,
}

impl Event {
    /// An event of this line with all values zero.
    pub const fn new(line: Line) -> Self {
        Self { line, bytes: [0; 3], a: 0, b: 0 }
    }

    /// Sets `%s`: a node ID.
    pub fn set_source(&mut self, source: u8) {
        self.bytes[Field::SOURCE as usize] = source;
    }

    /// Sets `%t`: a transfer ID.
    pub fn set_transfer(&mut self, transfer: u8) {
        self.bytes[Field::TRANSFER as usize] = transfer;
    }

    /// Sets `%c`, a code, `%w`, the number of a line to insert, or `%o`, a set of outputs: a bit
    /// each.
    pub fn set_code(&mut self, code: u8) {
        self.bytes[Field::CODE as usize] = code;
    }

    /// Sets the line.
    pub fn set_line(&mut self, line: Line) {
        self.line = line;
    }

    /// Sets `%a`.
    pub fn set_a(&mut self, a: u16) {
        self.a = a;
    }

    /// Sets `%b`.
    pub fn set_b(&mut self, b: u16) {
        self.b = b;
    }
}
