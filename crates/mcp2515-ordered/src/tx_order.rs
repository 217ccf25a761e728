//! Keeps frames in order through the MCP2515's three transmit buffers.
//!
//! The chip sends the buffer with the highest TXP first, and of buffers with equal TXP the one with
//! the highest number (DS20001801J 3.2). So a buffer and a priority together are a rank, and the
//! chip sends a frame after all waiting frames if its rank is lower than theirs. The driver assigns
//! ranks downwards. When none is left, the next frame waits until all buffers are empty, and the
//! ranks start again from the top. So there is at most one gap in twelve frames.

use core::num::NonZeroU8;

/// A transmit buffer and a priority: TXP in bits 4 and 3; 4, 2 or 1 for TXB2, TXB1 or TXB0 below.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rank(NonZeroU8);

impl Rank {
    const HIGHEST: Self = Self(NonZeroU8::new(3 << 3 | 4).unwrap());

    /// TXP, 0 to 3.
    pub fn priority(self) -> u8 {
        self.0.get() >> 3
    }

    /// The buffer as a bit: 1, 2 or 4 for TXB0, TXB1 or TXB2.
    pub fn buffer(self) -> u8 {
        self.0.get() & 7
    }

    /// The TXREQ of the buffer in the answer to READ STATUS: 0x04, 0x10 or 0x40 for buffer 1, 2 or
    /// 4.
    pub fn status(self) -> u8 {
        // The square of a power of two is a power of two, and an AVR multiplies faster than it
        // shifts.
        self.buffer().wrapping_mul(self.buffer()) << 2
    }

    /// Returns the next lower rank.
    fn next(self) -> Option<Self> {
        // From TXB0 to TXB2 of the next lower priority, or to the next lower buffer.
        let down = if self.buffer() == 1 { 5 } else { self.buffer() >> 1 };
        // Below the lowest rank the subtraction wraps around. An AVR needs the fewest instructions.
        let rank = self.0.get().wrapping_sub(down);
        NonZeroU8::new(rank).filter(|rank| *rank < Self::HIGHEST.0).map(Self)
    }
}

/// The rank that was assigned last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TxOrder(Option<Rank>);

impl TxOrder {
    /// The order for a chip without frames to send.
    pub const fn new() -> Self {
        Self(None)
    }

    /// Returns the rank for the next frame, or `None` if no free rank keeps the order. `busy` is
    /// the buffers that wait or are being sent, as bits of READ STATUS.
    pub fn next(&mut self, busy: u8) -> Option<Rank> {
        let rank = if busy == 0 { Rank::HIGHEST } else { self.0?.next()? };
        // The driver fills the buffers in a fixed order, and the chip empties them in the same
        // order. So if this one is busy, all are.
        if busy & rank.status() != 0 {
            return None;
        }
        self.0 = Some(rank);
        Some(rank)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the buffer that the chip sends next, by the datasheet.
    fn chip_sends(waiting: &[Option<(u8, u32)>; 3]) -> Option<usize> {
        (0..3).filter(|&b| waiting[b].is_some()).max_by_key(|&b| (waiting[b].unwrap().0, b))
    }

    #[test]
    fn frames_are_sent_in_order_with_any_interleaving_of_loading_and_sending() {
        let mut random: u32 = 1;
        let mut order = TxOrder::new();
        let mut waiting: [Option<(u8, u32)>; 3] = [None; 3];
        let (mut loaded, mut sent) = (0, 0);
        while sent < 10_000 {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let busy =
                (0..3).fold(0, |mask, b| mask | u8::from(waiting[b].is_some()) << (2 * b + 2));
            if random >> 16 & 1 == 0 {
                if let Some(rank) = order.next(busy) {
                    let buffer = rank.buffer().trailing_zeros() as usize;
                    assert!(waiting[buffer].is_none(), "a busy buffer was handed out");
                    waiting[buffer] = Some((rank.priority(), loaded));
                    loaded += 1;
                }
            } else if let Some(buffer) = chip_sends(&waiting) {
                assert_eq!(waiting[buffer].take().unwrap().1, sent);
                sent += 1;
            }
        }
    }

    #[test]
    fn three_frames_fill_the_three_buffers_and_the_fourth_waits() {
        let mut order = TxOrder::new();
        let mut busy = 0;
        for _ in 0..3 {
            busy |= order.next(busy).unwrap().status();
        }
        assert_eq!(busy, 0b0101_0100);
        assert_eq!(order.next(busy), None);
    }

    #[test]
    fn one_buffer_kept_full_lets_at_least_eleven_frames_follow_without_a_gap() {
        let mut order = TxOrder::new();
        let mut last = order.next(0).unwrap();
        let mut frames = 1;
        while let Some(rank) = order.next(last.status()) {
            last = rank;
            frames += 1;
        }
        assert!(frames >= 11, "{frames}");
    }
}
