//! Reads the EEPROM.

use crate::registers::{EEARH, EEARL, EECR, EEDR, EEPE, EERE};

/// Reads the byte at an address. The program must not be writing.
#[inline(always)]
pub fn read(address: u8) -> u8 {
    // A write that the program had started goes on in a reset. It ends within 4 ms.
    while EECR.has(EEPE) {}
    EEARH.write(0);
    EEARL.write(address);
    EECR.set(EERE);
    EEDR.read()
}
