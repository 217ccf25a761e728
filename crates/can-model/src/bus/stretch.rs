//! The stretches of a frame before and after its ACK slot, stepped at once.
//!
//! Goal: what a station or its owner can see is the same as if each bit had been stepped.
//!
//! While one station sends, all others receive, and there is no fault, each level is the sender's,
//! and each station's state is that of the recorder's engine, which gets every bit all the same.
//! Something can happen in the ACK slot, and from the bit on in which receivers accept the frame.
//! What the owners request meanwhile has no effect before the frame is over, or makes
//! [`Station::follower`] return `None`.
//!
//! [`Station::follower`]: crate::Station::follower

use super::{Bus, IDLE_HORIZON_BITS};
use crate::port::{Pace, PortId};
use crate::wire::WireBits;
use sim_base::Cycles;

/// A frame and its only sender.
struct Stretch {
    sender: PortId,
    bits: WireBits,
    /// Number of bits that are over.
    at: u8,
    /// True if a station whose cable is disconnected may begin a frame of its own meanwhile.
    has_outsider: bool,
}

impl Stretch {
    /// Number of bits up to the next one in which something can happen.
    fn left(&self) -> u64 {
        let ack_slot = self.bits.ack_slot();
        let end = if self.at <= ack_slot { ack_slot } else { self.bits.len() - 2 };
        u64::from(end.saturating_sub(self.at))
    }
}

impl Bus {
    /// Number of the next bits that are certainly a stretch, or `None` if the next one is not.
    pub(super) fn stretch_bits(&self) -> Option<u64> {
        let stretch = self.stretch()?;
        let limit = if stretch.has_outsider { IDLE_HORIZON_BITS - 1 } else { u64::MAX };
        Some(stretch.left().min(limit))
    }

    fn stretch(&self) -> Option<Stretch> {
        let observer = self.recorder.observer();
        if observer.field().is_none() || self.faults.any() {
            return None;
        }
        let mut sending = None;
        let mut has_outsider = false;
        for (at, port) in self.ports.iter().enumerate().filter(|(_, port)| port.pace != Pace::Off) {
            if port.misses_frame || port.is_muted {
                return None;
            }
            if !port.connected {
                has_outsider = true;
                continue;
            }
            let mut station = port.station.borrow_mut();
            let engine = station.follower().filter(|engine| engine.follows(observer))?;
            if let Some((bits, over)) = engine.sent()
                && sending.replace((PortId(at), bits, over)).is_some()
            {
                return None;
            }
        }
        let (sender, bits, at) = sending?;
        let stretch = Stretch { sender, bits, at, has_outsider };
        (stretch.left() > 0).then_some(stretch)
    }

    /// Steps the bits of a stretch that end at `t` or before. Returns false if there is none.
    pub(super) fn run_stretch(&mut self, t: Cycles) -> bool {
        let Some(stretch) = self.stretch() else { return false };
        let bits = stretch.left().min(self.clock.bits_until(t));
        let last = self.clock.after(bits - 1);
        let mut outsiders = self.ports.iter().filter(|port| !port.connected);
        if !outsiders.all(|port| port.pace == Pace::Off || port.station.borrow().quiet(last)) {
            return false;
        }
        for at in (stretch.at..).take(bits as usize) {
            let (start, end, level) =
                (self.clock.start(), self.clock.after(1), stretch.bits.get(at));
            if self.recorder.needs_sender() {
                self.recorder.set_sender(Some(stretch.sender));
            }
            self.set_level(start, level);
            self.recorder.bit(level, start, end);
            self.clock.advance(1);
        }
        for port in self.ports.iter().filter(|port| port.pace != Pace::Off) {
            let mut station = port.station.borrow_mut();
            if !port.connected {
                station.skip_idle(bits);
            } else if let Some(engine) = station.follower() {
                engine.follow(self.recorder.observer(), bits as u8);
            }
        }
        true
    }
}
