//! The chip on the bus: steps the engine bit by bit, and updates the registers with its events.
//!
//! The bus may lag behind the SPI side by up to its horizon. So requests have the time of their SPI
//! byte, and have no effect on a bit that began earlier. A reset in a frame has its effect on the
//! SPI side at once, and the frame goes on with the old engine ([`Leaving`]) up to that time.
//!
//! Source: DS20001801J sections 3 (Figure 3-1), 6, 7.4, 10.

use super::registers::int;
use super::transmit::Failure;
use super::{Mcp2515, Mode};
use can_model::{Engine, Event, Level, Station};
use sim_base::Cycles;

/// The engine of a chip that was reset while a frame was on the bus, which has not come to the time
/// of the reset yet.
#[derive(Debug)]
pub(super) struct Leaving {
    engine: Engine,
    bit_ps: Option<u64>,
    /// The time of the reset.
    until: Cycles,
}

impl Station for Mcp2515 {
    fn drive(&mut self, at: Cycles) -> Level {
        if let Some(leaving) = &mut self.leaving
            && at < leaving.until
        {
            return leaving.engine.drive(None);
        }
        self.leaving = None;
        self.catch_up(at);
        self.join_bus(at);
        if self.joining.is_some() {
            return self.can.drive(None);
        }
        match self.mode {
            Mode::Normal => self.drive_engine(at),
            Mode::ListenOnly => self.can.drive(None),
            Mode::Loopback => {
                self.looped_level = self.drive_engine(at);
                Level::Recessive
            }
            Mode::Configuration | Mode::Sleep => Level::Recessive,
        }
    }

    fn sample(&mut self, level: Level, at: Cycles) {
        if let Some(leaving) = &mut self.leaving {
            leaving.engine.sample(level);
            return;
        }
        if self.joining.is_some() {
            self.can.sample(level);
            self.finish_joining();
            return;
        }
        let mut frame_over = false;
        match self.mode {
            Mode::Normal | Mode::ListenOnly | Mode::Loopback => {
                let heard = match self.mode {
                    Mode::Loopback => self.looped_level,
                    _ => level,
                };
                for event in self.can.sample(heard) {
                    frame_over |= matches!(event, Event::Received(_) | Event::Transmitted(_));
                    self.handle(event, at);
                }
                self.follow_errors();
            }
            Mode::Sleep if level == Level::Dominant => self.bus_activity(at),
            Mode::Sleep | Mode::Configuration => {}
        }
        if self.request.is_some() {
            self.try_mode_change(at, frame_over);
        }
    }

    fn quiet(&self, at: Cycles) -> bool {
        if self.leaving.is_some()
            || self.joining.is_some()
            || self.waking_until.is_some_and(|until| until <= at)
            || self.is_mode_change_due(at)
        {
            return false;
        }
        match self.mode {
            Mode::Normal | Mode::Loopback => self.can.is_idle() && self.next_to_send(at).is_none(),
            Mode::ListenOnly => self.can.is_idle(),
            Mode::Configuration | Mode::Sleep => true,
        }
    }

    fn transmitting(&self) -> bool {
        if let Some(leaving) = &self.leaving {
            return leaving.engine.transmitting();
        }
        self.mode != Mode::Loopback && self.can.transmitting()
    }

    /// In sleep the chip monitors the bus; in configuration mode it is off.
    fn bit_time_ps(&self) -> Option<u64> {
        if let Some(leaving) = &self.leaving {
            return leaving.bit_ps;
        }
        let off = self.mode == Mode::Configuration && self.request.is_none();
        (!off).then(|| {
            let cnf = self.cnf();
            if self.bit_ps.get().0 != cnf || self.bit_ps.get().1 == 0 {
                let nominal = self.bit_timing().bit_time_ps(self.osc_hz);
                let rate = 1_000_000_u64.saturating_add_signed(self.osc_ppm.into());
                self.bit_ps.set((cnf, nominal * 1_000_000 / rate));
            }
            self.bit_ps.get().1
        })
    }

    /// A quiet chip does not count idle bits.
    fn skip_idle(&mut self, _bits: u64) {}

    fn follower(&mut self) -> Option<&mut Engine> {
        let is_steady = self.mode.is_on_the_bus()
            && self.leaving.is_none()
            && self.joining.is_none()
            && self.request.is_none()
            && self.waking_until.is_none();
        is_steady.then_some(&mut self.can)
    }
}

impl Mcp2515 {
    /// A reset at `at`: the bus, which may lag behind, goes on with the engine of before up to
    /// then.
    pub(super) fn leave_bus(&mut self, at: Cycles) {
        if self.leaving.is_none()
            && self.mode.is_on_the_bus()
            && self.joining.is_none()
            && !self.can.is_idle()
        {
            let bit_ps = self.bit_time_ps();
            let engine = self.can.clone();
            self.leaving = Some(Leaving { engine, bit_ps, until: at });
        }
    }

    /// Offers the next frame to the engine, and notes if the engine begins to send it.
    fn drive_engine(&mut self, at: Cycles) -> Level {
        let candidate = self.next_to_send(at);
        let was_transmitting = self.can.transmitting();
        let frame = candidate.and_then(|n| self.tx[n].frame());
        let level = self.can.drive(frame);
        if !was_transmitting && self.can.transmitting() {
            self.in_flight = candidate;
        }
        level
    }

    fn handle(&mut self, event: Event, at: Cycles) {
        match event {
            Event::Received(frame) => self.receive(frame, at),
            Event::Transmitted(_) => self.tx_succeeded(),
            Event::ArbitrationLost => self.tx_failed(Failure::LostArbitration),
            Event::Error { transmitting, .. } => {
                self.raise(int::MERR);
                if self.mode == Mode::ListenOnly
                    && let Some(frame) = self.can.broken_frame()
                {
                    self.receive(frame, at);
                }
                if transmitting {
                    self.tx_failed(Failure::BusError);
                }
            }
            // EFLG follows the engine's state, not its events.
            Event::BusOff | Event::Recovered | Event::Overload => {}
        }
    }
}
