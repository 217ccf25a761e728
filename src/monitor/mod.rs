//! The serial monitor: logs events as lines of text, at the rate of the UART.
//!
//! The node queues an [`Event`] of eight bytes, and [`Monitor`] makes its text later. Without the
//! feature `monitor` there are no texts, and events go nowhere.

#[cfg(feature = "monitor")]
mod lines;
#[cfg(not(feature = "monitor"))]
mod silent;
pub mod text;

use crate::progmem::Progmem;
#[cfg(feature = "monitor")]
pub use lines::Monitor;
#[cfg(not(feature = "monitor"))]
pub use silent::Monitor;
pub use text::Line;
use text::{Field, Texts};

/// True if the program has a serial monitor.
pub const IS_THERE: bool = cfg!(feature = "monitor");

/// The texts in flash.
pub const TEXTS: &[u8] = if IS_THERE { &text::PACKED } else { &[] };

/// A line to log, with the values for its fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// The text.
    pub line: Line,
    /// The values of the fields of one byte, in the order of their codes: source, transfer, code.
    bytes: [u8; 3],
    /// `%a`: a number. `%+`: the sign of a signed number. `%0` to `%3`: its magnitude with 0 to 3
    /// decimal places.
    pub a: u16,
    /// `%b`: a number. `%p`: a number in halves. `%v`: the number of a line to insert. `%n`: the
    /// number of a parameter whose name to insert.
    pub b: u16,
}

impl Line {
    /// True if the line logs that something was refused.
    pub fn is_refusal(self) -> bool {
        self <= Self::RefusedValue
    }

    /// True if the line logs a command for other nodes.
    #[inline(always)]
    pub fn is_elsewhere(self) -> bool {
        #[cfg(feature = "outputs")]
        return matches!(self, Self::CommandElsewhere | Self::RawCommandElsewhere);
        #[cfg(not(feature = "outputs"))]
        return self == Self::CommandElsewhere;
    }
}

impl Event {
    /// An event of this line with all values zero.
    pub const fn new(line: Line) -> Self {
        Self { line, bytes: [0; 3], a: 0, b: 0 }
    }

    /// Sets `%s`: a node ID.
    #[inline(always)]
    pub fn set_source(&mut self, source: u8) {
        self.bytes[Field::SOURCE as usize] = source;
    }

    /// Sets `%t`: a transfer ID.
    #[inline(always)]
    pub fn set_transfer(&mut self, transfer: u8) {
        self.bytes[Field::TRANSFER as usize] = transfer;
    }

    /// Sets `%c` or `%x`, a code in decimal or hexadecimal, or `%w`, the number of a line to
    /// insert.
    #[inline(always)]
    pub fn set_code(&mut self, code: u8) {
        self.bytes[Field::CODE as usize] = code;
    }
}

/// Access to the texts and to the names of the parameters (`%n`) in flash.
pub trait TextsAndNames: Progmem<Texts> {
    /// Index of the first name, counted from the first byte of the texts. The length of each name
    /// is stored before it.
    const NAMES: u16;
}
