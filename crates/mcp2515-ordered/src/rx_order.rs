//! Keeps frames in order through the MCP2515's two receive buffers.
//!
//! With BUKT set a frame that finds RXB0 full goes on to RXB1. So of two full buffers, seen when both had been seen empty
//! before, RXB0 holds the older frame. But a frame can roll over into RXB1 while RXB0 is being read, and the next one then
//! lands in RXB0: now RXB1 is the older. Both happen between two looks at the chip, and look the same afterwards.
//!
//! What tells them apart is the moment after RXB0 was emptied. If INT is high then, both buffers are empty. If it is low,
//! the driver looks at once. No whole frame fits between the release and that look (a frame takes 67 us or more, the look
//! 5 us), so whatever RXB1 holds then came before whatever RXB0 holds.
//!
//! Frames that only RXB1's own filters accept go there at once. They keep their order among themselves, but not with those
//! that came through RXB0.

/// A receive buffer, as the bit of its flag in CANINTF and in READ STATUS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Buffer {
    /// RXB0
    Rxb0 = 1 << 0,
    /// RXB1
    Rxb1 = 1 << 1,
}

const BOTH: u8 = Buffer::Rxb0 as u8 | Buffer::Rxb1 as u8;

/// Beside the buffers: of two full ones RXB1 is the older.
const RXB1_FIRST: u8 = 1 << 2;

/// Which buffers are known to be full, and the order to read them in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RxOrder(u8);

impl RxOrder {
    /// Nothing known.
    pub const fn new() -> Self {
        Self(0)
    }

    /// Whether a look at the chip is needed before anything can be read.
    pub fn is_empty(&self) -> bool {
        self.0 == 0
    }

    /// A look at the chip that comes any time after the buffers were last known to be empty. `status` is what READ STATUS
    /// answered.
    pub fn seen_late(&mut self, status: u8) {
        self.0 = status & BOTH;
    }

    /// A look at the chip right after RXB0 was emptied.
    pub fn seen_at_once(&mut self, status: u8) {
        self.seen_late(status);
        if self.0 == BOTH {
            self.0 |= RXB1_FIRST;
        }
    }

    /// Takes the buffer to read now.
    pub fn take(&mut self) -> Option<Buffer> {
        let buffer = match self.0 {
            0 => return None,
            order if order & (Buffer::Rxb0 as u8 | RXB1_FIRST) == Buffer::Rxb0 as u8 => Buffer::Rxb0,
            _ => Buffer::Rxb1,
        };
        self.0 &= BOTH & !(buffer as u8);
        Some(buffer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two buffers with rollover; frames are numbers.
    #[derive(Default)]
    struct Chip {
        rxb: [Option<u32>; 2],
    }

    impl Chip {
        fn arrives(&mut self, frame: u32) -> bool {
            let free = self.rxb.iter_mut().find(|buffer| buffer.is_none());
            free.map(|buffer| *buffer = Some(frame)).is_some()
        }

        fn status(&self) -> u8 {
            u8::from(self.rxb[0].is_some()) | u8::from(self.rxb[1].is_some()) << 1
        }
    }

    /// Frames arrive at random moments, at least 9 steps apart; a read takes 3 steps, a look 1, other work up to 40.
    #[test]
    fn frames_come_out_in_order_whenever_they_arrive() {
        let mut random: u32 = 7;
        let mut next_random = move |below: u32| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 16) % below
        };
        let (mut chip, mut order) = (Chip::default(), RxOrder::new());
        let (mut sent, mut due, mut last_read) = (0, 5, 0);
        let (mut received, mut now) = (0, 0);
        let mut wait = |steps: u32, chip: &mut Chip, next_random: &mut dyn FnMut(u32) -> u32| {
            now += steps;
            while due <= now {
                sent += 1;
                chip.arrives(sent);
                due += 9 + if next_random(3) == 0 { next_random(60) } else { 0 };
            }
        };
        for _ in 0..200_000 {
            if order.is_empty() {
                order.seen_late(chip.status());
                wait(1, &mut chip, &mut next_random);
            }
            let Some(buffer) = order.take() else {
                let other_work = next_random(40);
                wait(other_work, &mut chip, &mut next_random);
                continue;
            };
            wait(3, &mut chip, &mut next_random);
            let frame = chip.rxb[buffer as usize - 1].take().expect("a known full buffer is full");
            assert!(frame > last_read, "frame {frame} came out after {last_read}");
            last_read = frame;
            received += 1;
            if buffer == Buffer::Rxb0 && order.is_empty() && chip.status() != 0 {
                wait(1, &mut chip, &mut next_random);
                order.seen_at_once(chip.status());
            }
            let other_work = next_random(12);
            wait(other_work, &mut chip, &mut next_random);
        }
        assert!(received > 50_000, "{received} frames are too few to prove anything");
    }
}
