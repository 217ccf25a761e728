//! CAN_BAUDRATE 0: the node finds the bit rate of the bus.

/// The lowest value of CAN_BAUDRATE: the node finds the rate.
pub const LOWEST: i32 = -1;

/// The bit of a value of CAN_BAUDRATE that only [`LOWEST`] has.
const IS_ON: u8 = 0x80;

/// A search, and the rate with which the node listens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Search(u8);

impl Search {
    /// The node does not search.
    pub const NONE: Self = Self(0);

    /// The search of a node with this value of CAN_BAUDRATE. It begins with the highest rate.
    pub fn new(baudrate: u8) -> Self {
        Self(baudrate)
    }

    /// The value of CAN_BAUDRATE for the next lower rate. The highest, 3, follows the lowest, 0.
    /// `None` if the node does not search.
    pub fn take_next(&mut self) -> Option<u8> {
        if self.0 & IS_ON == 0 {
            return None;
        }
        self.0 = self.0.wrapping_sub(1) | IS_ON;
        Some(self.0 & 3)
    }
}
