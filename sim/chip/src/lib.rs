//! What every model of an ATmega168 or ATmega328P shares, whoever executes its instructions.
//!
//! [`Chip`] has the sizes of the memories. [`Firmware`] reads a program from an ELF or Intel HEX
//! file. [`PulseMeter`] measures pulses from the edges of a pin.
//!
//! The crate has no code of a processor, and compiles for any target of the Rust standard library.

#![forbid(unsafe_code)]

mod analog;
mod chip;
mod elf;
mod hex;
mod processor;
mod pulse;

/// First byte of the internal SRAM, after the registers.
pub const RAMSTART: u16 = 0x0100;

pub use analog::{WatchdogOscillator, oc2b_duty, power_on_ram};
pub use chip::Chip;
pub use elf::{Firmware, Symbol, value_of};
pub use processor::{
    Oc, PinWatcher, Reset, ResetCause, SerialCharacter, SpiByte, SpiDevice, State, TwiBus,
    Violation,
};
pub use pulse::{Pulse, PulseMeter};
