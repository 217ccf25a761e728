//! The EEPROM (datasheet 2545, section 8.4). A byte takes 3.4 ms to be written; it is begun, and never waited for.

use core::arch::asm;

use avr_device::atmega168::EEPROM;

/// The first 256 of its 512 bytes.
pub struct Eeprom {
    eeprom: EEPROM,
}

impl Eeprom {
    pub(super) fn new(eeprom: EEPROM) -> Self {
        // After a restart a byte may still be being written.
        for _ in 0..u16::MAX {
            if eeprom.eecr().read().eepe().bit_is_clear() {
                break;
            }
        }
        Self { eeprom }
    }
}

impl node::node::store::Eeprom for Eeprom {
    #[inline(never)]
    fn read(&self, at: u8) -> u8 {
        self.eeprom.eear().write(|w| w.set(u16::from(at)));
        // With EEPM 0: a write, too, which comes after a read here, is erase and write in one.
        self.eeprom.eecr().write(|w| w.eere().set_bit());
        self.eeprom.eedr().read().bits()
    }

    fn is_busy(&self) -> bool {
        self.eeprom.eecr().read().eepe().bit_is_set()
    }

    #[inline(never)]
    fn begin_write(&mut self, at: u8, byte: u8) {
        self.eeprom.eear().write(|w| w.set(u16::from(at)));
        self.eeprom.eedr().write(|w| w.set(byte));
        // EECR = 0x1F: EEMPE (bit 2), then within four cycles EEPE (bit 1).
        // Safety: writes only EECR, in the sequence that the datasheet asks for. No interrupt may come in between; they are
        // held back for seven cycles, and SREG (0x3F) is what it was.
        unsafe {
            asm!("in {sreg}, 0x3F", "cli", "sbi 0x1F, 2", "sbi 0x1F, 1", "out 0x3F, {sreg}", sreg = out(reg) _,
                options(nostack, preserves_flags));
        }
    }
}
