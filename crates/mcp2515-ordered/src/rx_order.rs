//! Keeps frames in order through the MCP2515's two receive buffers.
//!
//! With BUKT set, a frame that finds RXB0 full goes to RXB1. So if a check finds both buffers full
//! and the last check found both empty, RXB0 holds the older frame. But a frame can roll over to
//! RXB1 while the driver reads RXB0, and the next frame then goes to RXB0: now RXB1 holds the older
//! frame. Both sequences can happen between two checks of the chip, and the flags are the same
//! afterwards.
//!
//! The driver distinguishes them right after it has emptied RXB0. If INT is high then, both buffers
//! are empty. If INT is low, the driver checks the flags at once. No whole frame fits between the
//! release of RXB0 and this check, because a frame takes 67 us or more and the check 5 us.
//! So if RXB1 is full at this check, its frame is older than a frame in RXB0.
//!
//! Frames that only RXB1's own filters accept go directly to RXB1. They keep their order among
//! themselves, but not with frames from RXB0.

/// A receive buffer. The value is the bit of its flag in CANINTF and in READ STATUS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Buffer {
    /// RXB0
    Rxb0 = 1 << 0,
    /// RXB1
    Rxb1 = 1 << 1,
}

const BOTH: u8 = Buffer::Rxb0 as u8 | Buffer::Rxb1 as u8;

/// Bit beside the bits of the buffers: both are full, and RXB1 holds the older frame.
const RXB1_FIRST: u8 = 1 << 2;

/// The buffers that are known to be full, and the order in which to read them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RxOrder(u8);

impl RxOrder {
    /// No buffer is known to be full.
    pub const fn new() -> Self {
        Self(0)
    }

    /// True if no buffer is known to be full, so that the driver must check the flags before it
    /// reads a frame.
    pub fn is_empty(&self) -> bool {
        self.0 == 0
    }

    /// Takes the result of a check at any time after both buffers were known to be empty. `status`
    /// is the answer to READ STATUS.
    pub fn seen_late(&mut self, status: u8) {
        self.0 = status & BOTH;
    }

    /// Takes the result of a check right after the driver emptied RXB0.
    pub fn seen_at_once(&mut self, status: u8) {
        self.seen_late(status);
        if self.0 == BOTH {
            self.0 |= RXB1_FIRST;
        }
    }

    /// Removes and returns the buffer to read now.
    pub fn take(&mut self) -> Option<Buffer> {
        let buffer = match self.0 {
            0 => return None,
            order if order & (Buffer::Rxb0 as u8 | RXB1_FIRST) == Buffer::Rxb0 as u8 => {
                Buffer::Rxb0
            }
            _ => Buffer::Rxb1,
        };
        self.0 &= BOTH & !(buffer as u8);
        Some(buffer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two buffers with rollover. Frames are numbers.
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

    /// Frames arrive at random times, at least 9 steps apart. A read takes 3 steps, a check 1, and
    /// other work up to 40.
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
