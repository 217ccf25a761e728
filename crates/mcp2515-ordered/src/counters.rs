//! The counters of the driver. Without the feature `counters` all are zero and take no memory.

/// A counter. The value is the index of its first word in [`Counters`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Counter {
    /// Frames passed to the chip. 32 bits.
    TxRequests = 0,
    /// Frames whose TXREQ the chip has cleared by itself. The driver counts them at the next
    /// supervision or the next frame. It counts none in one-shot mode, where the chip clears
    /// TXREQ after a failure, too. A frame in the chip during a restart is not counted at all.
    TxSuccess = 4,
    /// Frames given up after [`TX_TIMEOUT_MS`](crate::TX_TIMEOUT_MS). Includes a frame that the
    /// chip sent at the moment of the abort.
    TxTimedOut = 5,
    /// Frames read from the chip, including standard and remote frames. 32 bits.
    RxReceived = 7,
    /// Supervisions (every [`SUPERVISION_MS`](crate::SUPERVISION_MS)) that found RX0OVR or RX1OVR
    /// set. One or more frames were lost before each of them.
    RxOverflow = 9,
    /// The sum of the increases of the chip's receive error counter (REC) at the supervisions. An
    /// error adds 1 or 8 to REC, and a good frame subtracts 1, so the sum shows errors between
    /// good frames only in part.
    RxErrors = 10,
    /// Supervisions that found the chip bus-off when the supervision before had not. The chip can
    /// recover in 128 x 11 bit times (1.4 ms at 1 Mbit/s), so a supervision can miss a bus-off.
    BusOffs = 11,
}

impl Counter {
    const fn is_long(self) -> bool {
        matches!(self, Self::TxRequests | Self::RxReceived)
    }
}

/// Number of words in [`Counters`].
pub const WORDS: u8 = 12;

/// The counts since the driver was made, in words of 16 bits at the indices of [`Counter`]. A count
/// of 32 bits has its low word first. The counts wrap around. A restart of the chip does not change
/// them. Words 2, 3 and 6 are zero: an application can use them for its own counts, such as
/// frames that it does not pass to the driver.
#[cfg(feature = "counters")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters(pub [u16; WORDS as usize]);

#[cfg(feature = "counters")]
impl Counters {
    /// Counters that are all zero.
    pub const fn new() -> Self {
        Self([0; WORDS as usize])
    }

    /// Returns the word `n`, or 0 if there is none.
    #[inline(always)]
    pub fn word(&self, n: u8) -> u16 {
        self.0.get(usize::from(n)).copied().unwrap_or(0)
    }

    /// Adds `more` to a count of 16 bits.
    #[inline(never)]
    pub(crate) fn add(&mut self, counter: Counter, more: u8) {
        let word = &mut self.0[counter as usize];
        *word = word.wrapping_add(u16::from(more));
    }

    /// Adds 1 to a count of 32 bits.
    #[inline(always)]
    pub(crate) fn count_long(&mut self, counter: Counter) {
        let low = &mut self.0[counter as usize];
        *low = low.wrapping_add(1);
        if *low == 0 {
            let high = &mut self.0[counter as usize + 1];
            *high = high.wrapping_add(1);
        }
    }
}

/// Without the feature `counters`: counts nothing.
#[cfg(not(feature = "counters"))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters;

#[cfg(not(feature = "counters"))]
impl Counters {
    /// Counters that take no memory.
    pub const fn new() -> Self {
        Self
    }

    /// Returns 0.
    #[inline(always)]
    pub fn word(&self, _n: u8) -> u16 {
        0
    }

    #[inline(always)]
    pub(crate) fn add(&mut self, _counter: Counter, _more: u8) {}

    #[inline(always)]
    pub(crate) fn count_long(&mut self, _counter: Counter) {}
}

impl Counters {
    /// Returns the value of a counter.
    pub fn get(&self, counter: Counter) -> u32 {
        let at = counter as u8;
        let high = if counter.is_long() { self.word(at + 1) } else { 0 };
        u32::from(high) << 16 | u32::from(self.word(at))
    }
}
