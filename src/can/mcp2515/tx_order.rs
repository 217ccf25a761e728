//! Keeps frames in order through the MCP2515's three transmit buffers.
//!
//! The chip sends the buffer with the highest TXP first, and of equal ones the buffer with the highest number (DS20001801J
//! 3.2). Ranking a buffer at a priority as `3 * TXP + buffer`, a frame leaves after all that are waiting if its rank is
//! lower than theirs. So ranks are handed out downwards from 11, skipping busy buffers; when no lower one is left, the
//! next frame waits until all have gone, and the ranks start again from the top. At most one gap in twelve frames.

/// Buffers of the chip.
pub const BUFFERS: u8 = 3;

/// A transmit buffer and the priority that puts its frame behind all others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// 0 to 2.
    pub buffer: u8,
    /// TXP, 0 to 3.
    pub priority: u8,
}

/// The rank handed out last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TxOrder {
    last: u8,
}

impl TxOrder {
    /// For a chip with nothing to send.
    pub const fn new() -> Self {
        Self { last: 0 }
    }

    /// The slot for the next frame, given which buffers (bit n for buffer n) still wait or are being sent; `None` while
    /// there is none that would keep the order.
    pub fn next(&mut self, busy: u8) -> Option<Slot> {
        if busy == 0 {
            self.last = 4 * BUFFERS;
        }
        let (mut rank, mut priority, mut buffer) = (4 * BUFFERS, 4u8, 0u8);
        while rank > 0 {
            rank -= 1;
            // Counted down alongside, because the AVR has no division.
            if buffer == 0 {
                buffer = BUFFERS;
                priority -= 1;
            }
            buffer -= 1;
            if rank < self.last && busy & (1 << buffer) == 0 {
                self.last = rank;
                return Some(Slot { buffer, priority });
            }
        }
        None
    }
}

impl Default for TxOrder {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The chip's choice among waiting buffers, as the datasheet has it.
    fn chip_sends(waiting: &[Option<(u8, u32)>; 3]) -> Option<usize> {
        (0..3).filter(|&b| waiting[b].is_some()).max_by_key(|&b| (waiting[b].unwrap().0, b))
    }

    #[test]
    fn frames_leave_in_order_however_loading_and_sending_interleave() {
        let mut random: u32 = 1;
        let mut order = TxOrder::new();
        let mut waiting: [Option<(u8, u32)>; 3] = [None; 3];
        let (mut loaded, mut sent) = (0, 0);
        while sent < 10_000 {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let busy = (0..3).fold(0, |mask, b| mask | u8::from(waiting[b].is_some()) << b);
            if random >> 16 & 1 == 0 {
                if let Some(slot) = order.next(busy) {
                    assert!(waiting[usize::from(slot.buffer)].is_none(), "a busy buffer was handed out");
                    waiting[usize::from(slot.buffer)] = Some((slot.priority, loaded));
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
            busy |= 1 << order.next(busy).unwrap().buffer;
        }
        assert_eq!(busy, 0b111);
        assert_eq!(order.next(busy), None);
    }

    #[test]
    fn one_buffer_kept_full_lets_at_least_eleven_frames_follow_without_a_gap() {
        let mut order = TxOrder::new();
        let mut last = order.next(0).unwrap();
        let mut frames = 1;
        while let Some(slot) = order.next(1 << last.buffer) {
            last = slot;
            frames += 1;
        }
        assert!(frames >= 11, "{frames}");
    }
}
