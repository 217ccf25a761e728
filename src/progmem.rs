//! Tables of constants that stay in flash.
//!
//! The start-up code of the AVR copies a constant that is used by reference to RAM, and RAM is one
//! kilobyte. So each module packs its table into bytes at compile time, [`image`](crate::image)
//! joins the tables, and the board places the image in flash and reads it byte by byte.

/// Access to the table `T` in flash.
pub trait Progmem<T>: Copy {
    /// Reads the byte at index `at` of the table.
    fn byte(self, at: u16) -> u8;

    /// Reads two bytes of the table, little-endian, from index `at` on.
    #[inline(never)]
    fn word(self, at: u16) -> u16 {
        u16::from_le_bytes([self.byte(at), self.byte(at.wrapping_add(1))])
    }
}
