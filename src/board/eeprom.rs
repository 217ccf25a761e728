//! The EEPROM (datasheet 2545, section 8.4). Writing a byte takes 3.4 ms. The program starts it and
//! does not wait for the end.

#![allow(
    clippy::unnecessary_cast,
    reason = "an address has 8 bits, or 16 with the feature outputs"
)]

use core::arch::asm;

use super::chip::EEPROM;
use firmware::eeprom::Address;

/// The bytes of the EEPROM that the program uses.
pub struct Eeprom {
    eeprom: EEPROM,
}

impl Eeprom {
    pub(super) fn new(eeprom: EEPROM) -> Self {
        // After a restart of the program, a write that it had started may still be active.
        for _ in 0..u16::MAX {
            if eeprom.eecr.read().eepe().bit_is_clear() {
                break;
            }
        }
        Self { eeprom }
    }
}

impl firmware::eeprom::Eeprom for Eeprom {
    #[inline(never)]
    fn read(&self, at: Address) -> u8 {
        self.eeprom.eear.write(|w| w.bits(at as u16));
        // This sets EEPM to 0, so that a write after this read erases and writes in one operation.
        self.eeprom.eecr.write(|w| w.eere().set_bit());
        self.eeprom.eedr.read().bits()
    }

    fn is_busy(&self) -> bool {
        self.eeprom.eecr.read().eepe().bit_is_set()
    }

    #[inline(never)]
    fn begin_write(&mut self, at: Address, byte: u8) {
        self.eeprom.eear.write(|w| w.bits(at as u16));
        self.eeprom.eedr.write(|w| w.bits(byte));
        // EECR = 0x1F: EEMPE (bit 2), then within four cycles EEPE (bit 1).
        // Safety: the block writes only EECR, in the sequence that the datasheet requires. No
        // interrupt may come in between, so interrupts are disabled for seven cycles. SREG
        // (0x3F) is restored.
        unsafe {
            asm!("in {sreg}, 0x3F", "cli", "sbi 0x1F, 2", "sbi 0x1F, 1", "out 0x3F, {sreg}",
                sreg = out(reg) _, options(nostack, preserves_flags));
        }
    }
}
