//! A build without the feature `any-rate`: CAN_BAUDRATE is a rate.

/// The lowest value of CAN_BAUDRATE: 125 kbit/s.
pub const LOWEST: i32 = 0;

/// No search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Search;

impl Search {
    /// No search.
    pub const NONE: Self = Self;

    /// No search.
    pub fn new(_baudrate: u8) -> Self {
        Self
    }

    /// There is no other rate.
    pub fn take_next(&mut self) -> Option<u8> {
        None
    }
}
