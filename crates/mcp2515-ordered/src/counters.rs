//! The counters of the driver. Without the feature `counters` all are zero and take no memory.

/// A counter. The value is the index of its first word in [`Counters`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Counter {
    /// Frames passed to the chip. 32 bits.
    TxRequests = 0,
    /// Frames whose TXREQ the chip has cleared by itself. The driver counts them at the next
    /// supervision or the next frame. It counts none in one-shot mode, where the chip clears
    /// TXREQ after a failure, too. A frame in the chip during a restart is not counted at all.
    TxSuccess = 4,
    /// Frames given up after [`TX_TIMEOUT_MS`](crate::TX_TIMEOUT_MS), and frames that were tried
    /// once on a bus of unknown bit rate. Includes a frame that the chip sent at that moment.
    TxTimedOut = 5,
    /// Frames read from the chip, including standard and remote frames. 32 bits.
    RxReceived = 7,
    /// Supervisions (every [`SUPERVISION_MS`](crate::SUPERVISION_MS)) that found RX0OVR or RX1OVR
    /// set. One or more frames were lost before each of them.
    RxOverflow = 9,
    /// The sum of the increases of the chip's receive error counter (REC) at the supervisions. An
    /// error adds 1 or 8 to REC, and a good frame subtracts 1, so the sum shows errors between
    /// good frames only in part. 32 bits, whose high word is behind all others.
    RxErrors = 10,
    /// Supervisions that found the chip bus-off when the supervision before had not. The chip can
    /// recover in 128 x 11 bit times (1.4 ms at 1 Mbit/s), so a supervision can miss a bus-off.
    BusOffs = 11,
}

impl Counter {
    /// The indices of the low and the high word of the count. A count of 16 bits has no high word:
    /// there the index is [`NO_WORD`].
    pub const fn words(self) -> [u8; 2] {
        let high = match self {
            Self::TxRequests | Self::RxReceived => self as u8 + 1,
            Self::RxErrors => WORDS,
            _ => NO_WORD,
        };
        [self as u8, high]
    }
}

/// Number of words in [`Counters`] that are the counters of CanStats, in its order.
pub const WORDS: u8 = 12;

/// An index without a word: it reads as 0.
pub const NO_WORD: u8 = u8::MAX;

/// The counts since the driver was made, in words of 16 bits at the indices of [`Counter`]. A count
/// of 32 bits has its words at [`Counter::words`]. The counts wrap around. A restart of the chip
/// does not change them. Words 2, 3 and 6 are zero: an application can use them for its own counts,
/// such as frames that it does not pass to the driver.
#[cfg(feature = "counters")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters(pub [u16; WORDS as usize + 1], u8);

#[cfg(feature = "counters")]
impl Counters {
    /// Counters that are all zero.
    pub const fn new() -> Self {
        Self([0; WORDS as usize + 1], 0)
    }

    /// Returns the word `n`, or 0 if there is none.
    pub fn word(&self, n: u8) -> u16 {
        self.0.get(usize::from(n)).copied().unwrap_or(0)
    }

    /// Adds `more` to a count.
    #[inline(never)]
    pub(crate) fn add(&mut self, counter: Counter, more: u8) {
        let [low, high] = counter.words();
        let word = &mut self.0[usize::from(low)];
        let (sum, is_carry) = word.overflowing_add(u16::from(more));
        *word = sum;
        if is_carry && let Some(word) = self.0.get_mut(usize::from(high)) {
            *word = word.wrapping_add(1);
        }
    }

    /// Adds 1 to a count for each bit of `buffers`.
    pub(crate) fn add_each(&mut self, counter: Counter, mut buffers: u8) {
        while buffers != 0 {
            buffers &= buffers - 1;
            self.add(counter, 1);
        }
    }

    /// Counts the errors by which REC has increased since the last call.
    pub(crate) fn note_rec(&mut self, rec: u8) {
        self.add(Counter::RxErrors, rec.saturating_sub(self.1));
        self.1 = rec;
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
    pub fn word(&self, _n: u8) -> u16 {
        0
    }

    pub(crate) fn add(&mut self, _counter: Counter, _more: u8) {}

    pub(crate) fn add_each(&mut self, _counter: Counter, _buffers: u8) {}

    pub(crate) fn note_rec(&mut self, _rec: u8) {}

    pub(crate) fn count_long(&mut self, _counter: Counter) {}
}

impl Counters {
    /// Returns the value of a counter.
    pub fn get(&self, counter: Counter) -> u32 {
        let [low, high] = counter.words().map(|n| self.word(n));
        u32::from(high) << 16 | u32::from(low)
    }
}

#[cfg(all(test, feature = "counters"))]
mod tests {
    use super::*;

    #[test]
    fn long_counts_carry_and_short_ones_wrap() {
        let mut counters = Counters::new();
        for _ in 0..300 {
            counters.add(Counter::RxErrors, 255);
            counters.add(Counter::RxOverflow, 255);
        }
        (0..65_536).for_each(|_| counters.count_long(Counter::RxReceived));
        assert_eq!(counters.get(Counter::RxErrors), 300 * 255);
        assert_eq!(counters.get(Counter::RxOverflow), 300 * 255 % 65_536);
        assert_eq!(counters.get(Counter::RxReceived), 65_536);
        assert_eq!(counters.get(Counter::BusOffs), 0);
    }
}
