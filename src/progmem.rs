//! Constant data that stays in flash, as one image: texts, parameters, and what the node says of itself.
//!
//! On the AVR a constant that is used by reference is copied to RAM at start, of which there is a kilobyte. So all tables
//! are packed into bytes at compile time, and the board places them in flash and reads them byte by byte.

use crate::monitor::text;
use crate::node::{acceptance, information, parameters};

/// The image, where the program runs.
pub trait Progmem: Copy {
    /// A byte of [`IMAGE`], by its address.
    fn byte(self, at: u16) -> u8;

    /// Two bytes of [`IMAGE`], the lower one first, by the address of that.
    #[inline(never)]
    fn word(self, at: u16) -> u16 {
        u16::from_le_bytes([self.byte(at), self.byte(at.wrapping_add(1))])
    }
}

/// The address of the image in the flash of an ATmega168: right behind its 26 interrupt vectors, where avr-libc's linker script has
/// constants. As it is known here, no place in the image has to be made an address first. `avr-specs/image.ld` sees to it.
pub const BEGIN: u16 = 26 * 4;

/// Where the texts of the serial monitor begin.
pub const TEXTS: u16 = BEGIN;
/// Where the table of parameters begins.
pub const PARAMETERS: u16 = TEXTS + text::PACKED.len() as u16;
/// Where the node's information about itself begins.
pub const INFORMATION: u16 = PARAMETERS + parameters::PACKED.len() as u16;

/// Where the controller's filters begin.
pub const ACCEPTANCE: u16 = INFORMATION + information::PACKED.len() as u16;

const LEN: usize = (ACCEPTANCE - BEGIN) as usize + acceptance::PACKED.len();

/// All of it.
pub const IMAGE: [u8; LEN] = {
    let mut image = [0; LEN];
    let parts: [(u16, &[u8]); 4] = [
        (TEXTS, &text::PACKED),
        (PARAMETERS, &parameters::PACKED),
        (INFORMATION, &information::PACKED),
        (ACCEPTANCE, &acceptance::PACKED),
    ];
    let mut part = 0;
    while part < parts.len() {
        let (start, bytes) = parts[part];
        let mut n = 0;
        while n < bytes.len() {
            image[(start - BEGIN) as usize + n] = bytes[n];
            n += 1;
        }
        part += 1;
    }
    image
};

/// The image as the host has it, for tests.
#[cfg(any(test, feature = "desk"))]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InMemory;

#[cfg(any(test, feature = "desk"))]
impl Progmem for InMemory {
    fn byte(self, at: u16) -> u8 {
        IMAGE[usize::from(at - BEGIN)]
    }
}
