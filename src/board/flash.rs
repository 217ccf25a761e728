//! Constant data that stays in flash.

use core::arch::asm;

use firmware::image::Table;
use firmware::progmem::Progmem;

use super::header::PROGRAM_FRONT;

/// Access to the image in flash.
#[derive(Clone, Copy)]
pub struct Image;

impl<T: Table> Progmem<T> for Image {
    fn byte(self, at: u16) -> u8 {
        let byte;
        let address = (&raw const PROGRAM_FRONT.image).addr() as u16 + T::BEGIN + at;
        // Safety: LPM only reads flash and changes no memory, whatever the address.
        unsafe {
            asm!("lpm {0}, Z", out(reg) byte, in("Z") address,
                options(pure, readonly, nostack, preserves_flags))
        };
        byte
    }

    // One pointer for both bytes, where the compiler would compute two.
    fn word(self, at: u16) -> u16 {
        let word;
        let address = (&raw const PROGRAM_FRONT.image).addr() as u16 + T::BEGIN + at;
        // Safety: as above.
        unsafe {
            asm!("lpm {0:l}, Z+", "lpm {0:h}, Z", out(reg_pair) word, inout("Z") address => _,
                options(pure, readonly, nostack, preserves_flags))
        };
        word
    }
}
