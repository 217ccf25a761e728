//! Constant data that stays in flash.

use core::arch::asm;

use node::progmem::{IMAGE, Progmem};

// Safety: the section is avr-libc's for constants that are only read with LPM, and this one is. Nothing else has that name.
#[unsafe(link_section = ".progmem.data")]
#[unsafe(no_mangle)]
#[used]
static IMAGE_IN_FLASH: [u8; IMAGE.len()] = IMAGE;

/// The image.
#[derive(Clone, Copy)]
pub struct Image;

impl Progmem for Image {
    #[inline(always)]
    fn byte(self, at: u16) -> u8 {
        let byte;
        // Safety: LPM has no effect but to read, and every address of the flash can be read.
        unsafe { asm!("lpm {0}, Z", out(reg) byte, in("Z") at, options(pure, readonly, nostack, preserves_flags)) };
        byte
    }
}
