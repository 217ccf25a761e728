//! Reads the EEPROM.

use core::arch::asm;

use crate::registers::{EEARH, EEARL, EECR, EEDR, EERE};

/// Reads the byte at an address.
#[inline(always)]
pub fn read(address: u8) -> u8 {
    // A write that the program had started goes on in a reset, and ends within 4 ms. EECR is 0x1F,
    // with EEPE in bit 1. SAFETY: the block only reads EECR.
    unsafe { asm!("2: sbic 0x1F, 1", "rjmp 2b", options(nomem, nostack, preserves_flags)) };
    EEARH.write(0);
    EEARL.write(address);
    EECR.set(EERE);
    EEDR.read()
}
