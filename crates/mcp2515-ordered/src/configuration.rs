//! The configuration: the registers that the driver writes in configuration mode.

use crate::bit_timing::BitTiming;
use crate::filters::Acceptance;
use crate::registers::{MODE_LISTEN_ONLY, MODE_LOOPBACK, OSM, RX0IE, RX1IE};

/// How often the chip tries to send a frame, and so its mode (DS20001801J 10).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Attempts {
    /// Until a node acknowledges the frame, or the driver gives it up after
    /// [`TX_TIMEOUT_MS`](crate::TX_TIMEOUT_MS).
    UntilSent = 0,
    /// Once, successful or not (DS20001801J 3.4, one-shot mode). For frames that several nodes may
    /// send with the same identifier: if the nodes repeated them, the frames would collide for
    /// ever.
    Once = OSM,
    /// Never: in listen-only mode the chip sends neither frames nor error frames, and acknowledges
    /// nothing. It also receives frames with errors (10.3). A frame that is passed to it stays in
    /// it until [`configure`](crate::Driver::configure) or
    /// [`reconfigure`](crate::Driver::reconfigure) removes it.
    Never = MODE_LISTEN_ONLY,
    /// In loopback mode the chip receives each frame that it sends, if its filters accept it, and
    /// neither sends to the bus nor receives from it. For tests without a bus.
    ToItself = MODE_LOOPBACK,
}

/// The settings that can change only while the chip is off the bus. [`new`](crate::Driver::new)
/// and [`configure`](crate::Driver::configure) take a configuration, and
/// [`reconfigure`](crate::Driver::reconfigure) changes it. Each of them restarts the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Configuration<A> {
    /// The bit rate and the sample point.
    pub timing: BitTiming,
    /// The filters and masks.
    pub acceptance: A,
    /// How often the chip tries to send a frame.
    pub attempts: Attempts,
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
