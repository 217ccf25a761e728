//! What the driver has seen, for dronecan.protocol.CanStats and uavcan.protocol.GetTransportStats. Without the feature `stats` nothing is
//! counted, and all numbers are zero.

/// A number of dronecan.protocol.CanStats (DSDL 343.CanStats), by its place among the 16-bit words after the first byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Counter {
    /// Frames handed to the chip. 32 bits.
    TxRequests = 0,
    /// Frames whose TXREQ the chip has cleared by itself, counted at the next look or the next frame. In one-shot mode none,
    /// because there the chip clears it after a failure, too. Frames in the chip when it is started over count nowhere.
    TxSuccess = 4,
    /// Frames given up because nothing had left for a second. One that just got through when it was given up counts here.
    TxTimedOut = 5,
    /// Frames read from the chip, foreign ones included. 32 bits.
    RxReceived = 7,
    /// Looks (every [`SUPERVISION_MS`](super::SUPERVISION_MS)) that found RX0OVR or RX1OVR set: one or more frames were lost before each.
    RxOverflow = 9,
    /// What the chip's receive error counter (REC) had grown by at each look, summed. An error adds 1, or 8 to it, and a
    /// good frame takes 1 away, so errors between good frames show in part only.
    RxErrors = 10,
    /// Looks that found the chip off the bus where the look before had not. It can be back in 128 x 11 bit times (1.4 ms at
    /// 1 Mbit/s), unseen.
    BusOffs = 11,
}

/// Words of [`Counters`].
pub const WORDS: u8 = 12;

/// The counters since the driver was made. They wrap around; a restart of the chip leaves them.
#[cfg(feature = "counters")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters(pub [u16; WORDS as usize]);

#[cfg(feature = "counters")]
impl Counters {
    /// All zero.
    pub const fn new() -> Self {
        Self([0; WORDS as usize])
    }

    /// Counts `more` of a number of 16 bits.
    #[inline(never)]
    pub(super) fn add(&mut self, counter: Counter, more: u8) {
        let word = &mut self.0[counter as usize];
        *word = word.wrapping_add(u16::from(more));
    }

    /// Counts one more of a number of 32 bits.
    #[inline(always)]
    pub(super) fn count_long(&mut self, counter: Counter) {
        let low = &mut self.0[counter as usize];
        *low = low.wrapping_add(1);
        if *low == 0 {
            let high = &mut self.0[counter as usize + 1];
            *high = high.wrapping_add(1);
        }
    }
}

#[cfg(feature = "counters")]
impl Counters {
    /// The word `n`; 0 if there is none.
    #[inline(always)]
    pub fn word(&self, n: u8) -> u16 {
        self.0.get(usize::from(n)).copied().unwrap_or(0)
    }
}

/// Counts nothing.
#[cfg(not(feature = "counters"))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters;

#[cfg(not(feature = "counters"))]
impl Counters {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    #[inline(always)]
    pub(super) fn add(&mut self, _counter: Counter, _more: u8) {}

    #[inline(always)]
    pub(super) fn count_long(&mut self, _counter: Counter) {}
}

#[cfg(not(feature = "counters"))]
impl Counters {
    /// The word `n`; 0 if there is none.
    #[inline(always)]
    pub fn word(&self, _n: u8) -> u16 {
        0
    }
}
