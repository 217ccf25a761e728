//! The wire: combines the levels that the stations drive, applies the faults, and returns the
//! result to the stations.
//!
//! Bits are stepped one by one, but for those in which nothing can happen: idle bits are skipped up
//! to the first in which a station has something to send, and a frame that has one sender and no
//! fault is stepped in two parts, before and after its ACK slot (`stretch`).
//!
//! # Order of calls
//! The caller that runs the AVRs reads [`Bus::horizon`], runs them up to there, then calls
//! [`Bus::run_until`] with the time that they reached. So a bit is stepped after its end: `drive`
//! is called for its start and `sample` for its end. Both are in the AVRs' past, so a station must
//! check the times of its requests. On an idle bus a request may be up to [`IDLE_HORIZON_BITS`] old
//! when its SOF is stepped. Its effects cannot be visible sooner, except an error or abort in its
//! first bits, which then shows up to that much late. For exact times a caller must read
//! the horizon again after each access to a station: it becomes shorter as soon as one is not
//! quiet.
//!
//! # Stations out of step
//! While a station has another bit rate, a bit is divided into events: the bus's bit begins, is
//! sampled, ends; the station's bit is sampled, ends and begins again. They are executed in the
//! order of their times, in picoseconds. The horizon is the next of them.

mod stretch;

use super::bit_clock::{BitClock, PS_PER_CYCLE};
use super::fault::{BitContext, Distortion, Fault, Faults};
use super::port::{Pace, Port, PortId, sample_point_ps};
use super::recorder::{BusStats, PortStats, Record, Recorder};
use super::station::StationRef;
use super::wire::Level;
use sim_base::Cycles;

/// The AVRs may run this far ahead while the bus is idle. The shortest frame is 44 bits, so no
/// frame that is requested in that time can have been received.
const IDLE_HORIZON_BITS: u64 = 32;

/// Called at each change of the wire's level.
pub type WireTap = Box<dyn FnMut(Cycles, Level)>;

/// A bit of the bus that is divided into events.
#[derive(Clone, Copy, Debug)]
struct OpenBit {
    distortion: Distortion,
    /// The level at the sample point; `None` before it.
    latched: Option<Level>,
}

/// One CAN bus.
pub struct Bus {
    bit_rate: u32,
    bit_ps: u64,
    clock: BitClock,
    ports: Vec<Port>,
    /// True if a port has its own clock.
    mixed: bool,
    open: Option<OpenBit>,
    faults: Faults,
    recorder: Recorder,
    level: Level,
    tap: Option<WireTap>,
}

impl Bus {
    /// A bus without stations at `bit_rate` bits per second.
    pub fn new(bit_rate: u32) -> Bus {
        let clock = BitClock::new(bit_rate);
        Bus {
            bit_rate,
            bit_ps: 1_000_000_000_000 / u64::from(bit_rate),
            clock,
            ports: Vec::new(),
            mixed: false,
            open: None,
            faults: Faults::default(),
            recorder: Recorder::new(),
            level: Level::Recessive,
            tap: None,
        }
    }

    /// Connects a station, which takes part from the next bit on.
    pub fn attach(&mut self, name: &str, station: StationRef) -> PortId {
        self.ports.push(Port::new(name, station));
        let stats = PortStats { name: name.to_owned(), ..PortStats::default() };
        self.recorder.stats.ports.push(stats);
        PortId(self.ports.len() - 1)
    }

    /// The name a station was attached with.
    pub fn name(&self, port: PortId) -> &str {
        &self.ports[port.0].name
    }

    /// Connects or disconnects a station's cable. A disconnected station receives only itself.
    pub fn connect(&mut self, port: PortId, connected: bool) {
        self.ports[port.0].connected = connected;
    }

    /// Adds a fault to those that are active.
    pub fn inject(&mut self, fault: Fault) {
        self.faults.inject(fault);
    }

    /// Ends all faults. Disconnected cables stay disconnected.
    pub fn clear_faults(&mut self) {
        self.faults.clear();
    }

    /// Bit rate in bits per second.
    pub fn bit_rate(&self) -> u32 {
        self.bit_rate
    }

    /// The level of the wire in the latest bit.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Calls `tap` at each change of the wire from now on, with the time and the new level. Times
    /// never go back, but changes come when their bit is stepped.
    pub fn set_wire_tap(&mut self, tap: Option<WireTap>) {
        self.tap = tap;
    }

    /// Frames and error frames since the last call. At most 65 536 are kept.
    pub fn take_records(&mut self) -> Vec<Record> {
        self.recorder.take_records()
    }

    /// Totals since the bus was created.
    pub fn stats(&self) -> BusStats {
        self.recorder.stats.clone()
    }

    /// All events up to this time have been stepped.
    pub fn now(&self) -> Cycles {
        self.clock.start()
    }

    /// The time up to which the AVRs may run before the bus must be stepped.
    pub fn horizon(&self) -> Cycles {
        if self.mixed || self.open.is_some() {
            return self.next_event().0.div_ceil(PS_PER_CYCLE);
        }
        if let Some(bits) = self.stretch_bits() {
            return self.clock.after(bits + 1);
        }
        let bits = self.idle_bits(IDLE_HORIZON_BITS);
        self.clock.after((bits + 1).min(IDLE_HORIZON_BITS))
    }

    /// Steps the bus: on return `sample` has been called for every bit whose end is at or before
    /// `t`.
    pub fn run_until(&mut self, t: Cycles) {
        loop {
            if self.open.is_some() || self.mixed {
                if !self.step_event(t) {
                    return;
                }
                continue;
            }
            if self.clock.after(1) > t {
                return;
            }
            self.update_paces();
            if self.mixed || self.skip_idle(t) || self.run_stretch(t) {
                continue;
            }
            self.step_bit();
        }
    }

    /// Applies changes of the stations' bit times.
    fn update_paces(&mut self) {
        let now = self.clock.start();
        let mut changed = false;
        for port in &mut self.ports {
            changed |= port.update_pace(self.bit_ps, now);
        }
        if changed {
            self.mixed = self.ports.iter().any(|port| matches!(port.pace, Pace::Own(_)));
        }
    }

    // ---- idle bus ----

    /// Number of the next `limit` bits that are certainly idle.
    fn idle_bits(&self, limit: u64) -> u64 {
        if !self.recorder.is_idle() || self.ports.iter().any(|port| port.misses_frame) {
            return 0;
        }
        let limit = limit.min(self.faults.harmless_idle_bits());
        // A station that is not quiet stays so: finds the first bit in which one is not.
        let (mut quiet, mut unknown) = (0, limit);
        let mut probe = limit;
        while quiet < unknown {
            if self.are_all_quiet(self.clock.after(probe - 1)) {
                quiet = probe;
            } else {
                unknown = probe - 1;
            }
            probe = (quiet + unknown).div_ceil(2);
        }
        quiet
    }

    fn are_all_quiet(&self, at: Cycles) -> bool {
        let mut on_bus = self.ports.iter().filter(|port| port.pace != Pace::Off);
        on_bus.all(|port| port.station.borrow().quiet(at))
    }

    /// Skips idle bits that end at `t` or before. Returns false if there is none.
    fn skip_idle(&mut self, t: Cycles) -> bool {
        if !self.recorder.is_idle() {
            return false;
        }
        let bits = self.idle_bits(self.clock.bits_until(t));
        if bits == 0 {
            return false;
        }
        self.set_level(self.clock.start(), Level::Recessive);
        self.clock.advance(bits);
        self.faults.skip_idle(bits);
        self.recorder.skip_idle(bits);
        let now_ps = self.clock.start() * PS_PER_CYCLE;
        for port in &mut self.ports {
            match &mut port.pace {
                Pace::Off => {}
                Pace::InStep => port.station.borrow_mut().skip_idle(bits),
                Pace::Own(clock) => {
                    let bits = clock.skip_idle(now_ps);
                    port.station.borrow_mut().skip_idle(bits);
                }
            }
        }
        true
    }

    // ---- all stations in step ----

    fn step_bit(&mut self) {
        let (start, end) = (self.clock.start(), self.clock.after(1));
        let (wire, distortion) = self.begin_bit(start);
        let level = distortion.apply(wire);
        self.set_level(start, level);
        self.end_bit(level, distortion, start, end);
    }

    /// Calls `drive` of the stations in step. Returns the combined level, and the faults of
    /// the bit.
    fn begin_bit(&mut self, start: Cycles) -> (Level, Distortion) {
        let idle = self.recorder.is_idle();
        for port in &mut self.ports {
            port.misses_frame &= !idle;
            port.is_muted &= !idle;
            if port.is_in_step() {
                port.driven = port.station.borrow_mut().drive(start);
            }
        }
        if self.faults.mutes_receivers() && self.recorder.is_ack_slot() {
            for port in &mut self.ports {
                port.is_muted = port.is_in_step() && !port.station.borrow().transmitting();
            }
        }
        if self.recorder.needs_sender() {
            self.recorder.set_sender(self.find_sender());
        }
        let wire = self.wire();
        let start_of_frame = wire.is_dominant() && self.recorder.is_free_for_sof();
        if start_of_frame {
            self.begin_frame();
        }
        if !self.faults.any() {
            return (wire, Distortion::default());
        }
        let context = BitContext { idle, start_of_frame, ack_slot: self.recorder.is_ack_slot() };
        (wire, self.faults.next_bit(context))
    }

    fn begin_frame(&mut self) {
        let mut drivers =
            self.ports.iter().enumerate().filter(|(_, port)| {
                port.is_heard() && port.is_in_step() && port.driven.is_dominant()
            });
        // A single sender is known now; among several, arbitration decides.
        let sender = match (drivers.next(), drivers.next()) {
            (Some((at, _)), None) => Some(PortId(at)),
            _ => None,
        };
        self.recorder.set_sender(sender);
        if self.faults.loses_frames() {
            let ports = &mut self.ports;
            self.faults.losers(|PortId(at)| {
                let port = &mut ports[at];
                port.misses_frame =
                    port.connected && port.is_in_step() && !port.driven.is_dominant();
                port.misses_frame
            });
        }
    }

    fn find_sender(&self) -> Option<PortId> {
        let sends = |port: &Port| {
            port.is_heard() && port.is_in_step() && port.station.borrow().transmitting()
        };
        self.ports.iter().position(sends).map(PortId)
    }

    /// The combined level of the stations.
    fn wire(&self) -> Level {
        let heard = self.ports.iter().filter(|port| port.is_heard());
        heard.fold(Level::Recessive, |level, port| level & port.driven)
    }

    fn end_bit(&mut self, level: Level, distortion: Distortion, start: Cycles, end: Cycles) {
        for (at, port) in self.ports.iter_mut().enumerate() {
            if port.is_in_step() {
                let seen = match port.connected {
                    true if distortion.fooled == Some(PortId(at)) => !level,
                    true if port.is_muted => level & port.driven,
                    true => level,
                    false => port.driven,
                };
                port.station.borrow_mut().sample(seen, end);
            }
        }
        self.recorder.bit(level, start, end);
        self.clock.advance(1);
    }

    fn set_level(&mut self, at: Cycles, level: Level) {
        if level != self.level {
            self.level = level;
            if let Some(tap) = &mut self.tap {
                tap(at, level);
            }
        }
    }

    // ---- some station out of step ----

    /// The next event, in picoseconds, and its port (`None`: the bus's own).
    fn next_event(&self) -> (u64, Option<usize>) {
        let start_ps = self.clock.start() * PS_PER_CYCLE;
        let bus_ps = match &self.open {
            None => start_ps,
            Some(OpenBit { latched: None, .. }) => start_ps + sample_point_ps(self.bit_ps),
            Some(OpenBit { latched: Some(_), .. }) => self.clock.after(1) * PS_PER_CYCLE,
        };
        let mut next = (bus_ps, None);
        for (at, port) in self.ports.iter().enumerate() {
            if let Pace::Own(clock) = &port.pace
                && clock.next_event_ps() < next.0
            {
                next = (clock.next_event_ps(), Some(at));
            }
        }
        next
    }

    /// Executes the next event if it is due at `t`.
    fn step_event(&mut self, t: Cycles) -> bool {
        let (at_ps, port) = self.next_event();
        if at_ps > t * PS_PER_CYCLE {
            return false;
        }
        let at = at_ps / PS_PER_CYCLE;
        match (port, self.open) {
            (Some(port), _) => self.step_port(port, at),
            (None, None) => return self.open_bit(t),
            (None, Some(bit)) => match bit.latched {
                None => self.open = Some(OpenBit { latched: Some(self.level), ..bit }),
                Some(level) => {
                    self.open = None;
                    self.end_bit(level, bit.distortion, self.clock.start(), at);
                }
            },
        }
        true
    }

    /// Begins a bit that is divided into events, or skips idle bits. Returns false if that is due
    /// later than `t`.
    fn open_bit(&mut self, t: Cycles) -> bool {
        self.update_paces();
        if !self.mixed {
            return true;
        }
        if self.skip_idle(t) {
            return true;
        }
        let start = self.clock.start();
        let (_, distortion) = self.begin_bit(start);
        self.open = Some(OpenBit { distortion, latched: None });
        self.settle(start);
        true
    }

    /// Sets the wire's new level.
    fn settle(&mut self, at: Cycles) {
        let level = self.wire();
        let level = self.open.map_or(level, |bit| bit.distortion.apply(level));
        self.set_level(at, level);
    }

    fn step_port(&mut self, at_port: usize, at: Cycles) {
        let level = self.level;
        let port = &mut self.ports[at_port];
        let seen = if port.connected { level } else { port.driven };
        let Pace::Own(clock) = &mut port.pace else {
            return;
        };
        match clock.latched {
            None => clock.latched = Some(seen),
            Some(latched) => {
                clock.begin_bit();
                let mut station = port.station.borrow_mut();
                station.sample(latched, at);
                port.driven = station.drive(at);
                drop(station);
                self.settle(at);
            }
        }
    }
}
