//! Constant data that stays in flash.

use core::arch::asm;

use node::image::{IMAGE, Table};
use node::progmem::Progmem;

// Safety: the section is avr-libc's for constants that are only read with LPM, and this one is. Nothing else has that name.
#[unsafe(link_section = ".progmem.data")]
#[unsafe(no_mangle)]
static IMAGE_IN_FLASH: [u8; IMAGE.len()] = IMAGE;

/// The image.
#[derive(Clone, Copy)]
pub struct Image;

impl<T: Table> Progmem<T> for Image {
    #[inline(always)]
    fn byte(self, at: u16) -> u8 {
        let byte;
        let address = (&raw const IMAGE_IN_FLASH).addr() as u16 + T::BEGIN + at;
        // Safety: LPM has no effect but to read, and every address of the flash can be read.
        unsafe {
            asm!("lpm {0}, Z", out(reg) byte, in("Z") address, options(pure, readonly, nostack, preserves_flags))
        };
        byte
    }
}
