//! Constant data that stays in flash.

use core::arch::asm;

use firmware::image::{IMAGE, Table};
use firmware::progmem::Progmem;

// Safety: `.progmem.data` is avr-libc's section for constants in flash. This constant is read only
// by LPM, in `Image::byte`. No other symbol of the program has this name.
#[unsafe(link_section = ".progmem.data")]
#[unsafe(no_mangle)]
static IMAGE_IN_FLASH: [u8; IMAGE.len()] = IMAGE;

/// Access to the image in flash.
#[derive(Clone, Copy)]
pub struct Image;

impl<T: Table> Progmem<T> for Image {
    #[inline(always)]
    fn byte(self, at: u16) -> u8 {
        let byte;
        let address = (&raw const IMAGE_IN_FLASH).addr() as u16 + T::BEGIN + at;
        // Safety: LPM only reads flash and changes no memory, whatever the address.
        unsafe {
            asm!("lpm {0}, Z", out(reg) byte, in("Z") address, options(pure, readonly, nostack, preserves_flags))
        };
        byte
    }
}
