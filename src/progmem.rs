//! Tables of constants that stay in flash.
//!
//! On the AVR a constant that is used by reference is copied to RAM at start, of which there is a kilobyte. So a table is packed into bytes at
//! compile time, by the module that it belongs to; [`image`](crate::image) puts all tables together, and the board places them in flash
//! and reads them byte by byte.

/// The flash that has the table `T`.
pub trait Progmem<T>: Copy {
    /// A byte of the table. `at` counts from its beginning.
    fn byte(self, at: u16) -> u8;

    /// Two bytes of the table, the lower one first; `at` is the place of that.
    #[inline(never)]
    fn word(self, at: u16) -> u16 {
        u16::from_le_bytes([self.byte(at), self.byte(at.wrapping_add(1))])
    }
}
