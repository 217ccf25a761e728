//! What the driver counts with the feature `counters`. Without it all numbers are zero, and take no memory.

/// A number of [`Counters`], by its place among the words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Counter {
    /// Frames handed to the chip. 32 bits.
    TxRequests = 0,
    /// Frames whose TXREQ the chip has cleared by itself, counted at the next supervision or the next frame. None in one-shot mode,
    /// where the chip clears it after a failure, too. A frame that is in the chip when it is started over counts nowhere.
    TxSuccess = 4,
    /// Frames given up after [`TX_TIMEOUT_MS`](crate::TX_TIMEOUT_MS). One that just got through when it was given up counts here.
    TxTimedOut = 5,
    /// Frames read from the chip, standard and remote ones included. 32 bits.
    RxReceived = 7,
    /// Supervisions (every [`SUPERVISION_MS`](crate::SUPERVISION_MS)) that found RX0OVR or RX1OVR set: one or more frames were lost
    /// before each.
    RxOverflow = 9,
    /// By how much the chip's receive error counter (REC) had grown at each supervision, summed. An error adds 1 or 8 to it, and a good
    /// frame takes 1 away, so errors between good frames show in part only.
    RxErrors = 10,
    /// Supervisions that found the chip off the bus where the one before had not. It can be back in 128 x 11 bit times (1.4 ms at
    /// 1 Mbit/s), unseen.
    BusOffs = 11,
}

impl Counter {
    const fn is_long(self) -> bool {
        matches!(self, Self::TxRequests | Self::RxReceived)
    }
}

/// Words of [`Counters`].
pub const WORDS: u8 = 12;

/// The counts since the driver was made, in words of 16 bits at the places of [`Counter`]; of 32 bits the low word is first. They wrap
/// around. A restart of the chip leaves them. Words 2, 3 and 6 are zero: room for what an application counts itself, such as frames that it
/// does not hand to the driver.
#[cfg(feature = "counters")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters(pub [u16; WORDS as usize]);

#[cfg(feature = "counters")]
impl Counters {
    /// All zero.
    pub const fn new() -> Self {
        Self([0; WORDS as usize])
    }

    /// The word `n`; 0 if there is none.
    #[inline(always)]
    pub fn word(&self, n: u8) -> u16 {
        self.0.get(usize::from(n)).copied().unwrap_or(0)
    }

    /// Counts `more` of a number of 16 bits.
    #[inline(never)]
    pub(crate) fn add(&mut self, counter: Counter, more: u8) {
        let word = &mut self.0[counter as usize];
        *word = word.wrapping_add(u16::from(more));
    }

    /// Counts one more of a number of 32 bits.
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

/// Counts nothing without the feature `counters`.
#[cfg(not(feature = "counters"))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters;

#[cfg(not(feature = "counters"))]
impl Counters {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// 0.
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
    /// A number.
    pub fn get(&self, counter: Counter) -> u32 {
        let at = counter as u8;
        let high = if counter.is_long() { self.word(at + 1) } else { 0 };
        u32::from(high) << 16 | u32::from(self.word(at))
    }
}
