//! The EEPROM: what the program needs of it.

use crate::hardware::OUTPUTS;

/// An address in the EEPROM: of as many bits as the build needs.
pub type Address = <() as Width<{ OUTPUTS == 1 }>>::Address;

/// An address of eight bits, or of more.
pub trait Width<const IS_SMALL: bool> {
    /// The integer.
    type Address;
}

impl Width<true> for () {
    type Address = u8;
}

impl Width<false> for () {
    type Address = u16;
}

/// Bytes of the EEPROM that the program uses.
pub const EEPROM_LEN: usize = if OUTPUTS == 1 { 0x100 } else { 0x400 };

/// An EEPROM of [`EEPROM_LEN`] bytes. Writing a byte takes milliseconds.
pub trait Eeprom {
    /// The byte at an address. Do not call while a byte is being written.
    fn read(&self, at: Address) -> u8;
    /// True while a byte is being written.
    fn is_busy(&self) -> bool;
    /// Begins to write a byte. Do not call while a byte is being written.
    fn begin_write(&mut self, at: Address, byte: u8);
}
