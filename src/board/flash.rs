//! Texts that stay in flash.

use core::arch::asm;

use node::monitor::text::{FlashText, PACKED};

// Safety: the section is avr-libc's for constants that are only read with LPM, and this one is.
#[unsafe(link_section = ".progmem.data")]
static TEXT: [u8; PACKED.len()] = PACKED;

/// The texts of the serial monitor.
pub struct Text;

impl FlashText for Text {
    fn byte(&self, index: u16) -> u8 {
        let address = TEXT.as_ptr().wrapping_add(usize::from(index));
        let byte;
        // Safety: LPM has no effect but to read, and every address of the flash can be read.
        unsafe {
            asm!("lpm {0}, Z", out(reg) byte, in("Z") address, options(pure, readonly, nostack, preserves_flags))
        };
        byte
    }
}
