//! The configuration: the registers that the driver writes in configuration mode.

use crate::bit_timing::BitTiming;
use crate::filters::Acceptance;
use crate::registers::{OSM, RX0IE, RX1IE};

/// How often the chip tries to send a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Attempts {
    /// Until a node acknowledges the frame, or the driver gives it up after
    /// [`TX_TIMEOUT_MS`](crate::TX_TIMEOUT_MS).
    UntilSent = 0,
    /// Once, successful or not (DS20001801J 3.4, one-shot mode). For frames that several nodes may
    /// send with the same identifier: if the nodes repeated them, the frames would collide for
    /// ever.
    Once = OSM,
}

/// The settings that can change only while the chip is off the bus. [`new`](crate::Mcp2515::new)
/// and [`configure`](crate::Mcp2515::configure) take a configuration, and
/// [`reconfigure`](crate::Mcp2515::reconfigure) changes it. Each of them restarts the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Configuration<A> {
    /// The bit rate and the sample point.
    pub timing: BitTiming,
    /// The filters and masks.
    pub acceptance: A,
    /// How often the chip tries to send a frame.
    pub attempts: Attempts,
}

impl<A> Configuration<A> {
    /// The value of CANCTRL on the bus: normal mode, and OSM in one-shot mode.
    pub(crate) fn canctrl(&self) -> u8 {
        self.attempts as u8
    }
}

impl<A: Acceptance> Configuration<A> {
    /// The value of the register at `address`, which is a register of a filter or a mask, CNF1 to
    /// CNF3, or CANINTE.
    #[inline(never)]
    pub(crate) fn register(&self, address: u8) -> u8 {
        // RXF0 to RXF2 begin at address 0, RXF3 to RXF5 at 0x10, the masks at 0x20, CNF3 at 0x28.
        let n = address.wrapping_sub((address & 0x30) >> 2);
        if n < 32 {
            self.acceptance.register(n)
        } else {
            // CANINTE follows CNF3, CNF2 and CNF1.
            self.timing.0.get(usize::from(n & 3)).copied().unwrap_or(RX0IE | RX1IE)
        }
    }
}
