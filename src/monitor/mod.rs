//! The serial monitor: logs events as lines of text, at the rate of the UART.
//!
//! The node queues an [`Event`] of eight bytes, and [`Monitor`] makes its text later. Without the
//! feature `monitor` there are no texts, and events go nowhere.

#[cfg(feature = "monitor")]
mod event;
#[cfg(feature = "monitor")]
mod lines;
pub mod packing;
#[cfg(not(feature = "monitor"))]
mod silent;
pub mod text;
mod told;

use crate::progmem::Progmem;
#[cfg(not(feature = "monitor"))]
pub use silent::{Event, Monitor};
use text::Texts;
pub use text::{Line, Words};
pub use told::{Change, Told};
#[cfg(feature = "monitor")]
pub use {event::Event, lines::Monitor};

/// True if the program has a serial monitor.
pub const IS_THERE: bool = cfg!(feature = "monitor");

/// The texts in flash.
pub const TEXTS: &[u8] = if IS_THERE { &packing::PACKED } else { &[] };

/// Access to the texts and to the names of the parameters (`%n`) in flash.
pub trait TextsAndNames: Progmem<Texts> {
    /// Index of the first name, counted from the first byte of the texts. The length of each name
    /// is stored before it.
    const NAMES: u16;
}
