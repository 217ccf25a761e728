//! A station's connection to the bus: its cable, its pace, the level that it drives.
//!
//! A station within [`IN_STEP_PPM`] of the bus's bit rate uses the bus's bits: resynchronisation
//! would keep a real controller in step. Other stations run on an [`OwnClock`], like a controller
//! with wrong bit timing: such a station drives when its own bits begin and samples the wire at its
//! own sample points, and so detects and causes stuff, form and bit errors.

use super::bit_clock::PS_PER_CYCLE;
use super::station::StationRef;
use super::wire::Level;
use sim_base::Cycles;

/// Identifies a station of a bus.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Hash)]
pub struct PortId(pub(super) usize);

impl PortId {
    /// Position in the order of attachment, from 0; the index into the port statistics.
    pub fn index(self) -> usize {
        self.0
    }
}

/// Largest difference of two clocks that still synchronise: the tolerance of ISO 11898-1 with a
/// jump width of one of eight quanta is 0.625 %, rounded down.
const IN_STEP_PPM: u64 = 5_000;

/// How a station is stepped.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Pace {
    /// Not on the bus.
    Off,
    /// With the bus's bits.
    InStep,
    /// With its own bits.
    Own(OwnClock),
}

/// The bits of a station that is out of step.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct OwnClock {
    bit_ps: u64,
    start_ps: u64,
    /// The level at this bit's sample point; `None` before it.
    pub latched: Option<Level>,
}

/// Position of the sample point in a bit: 75 %, recommended for 1 Mbit/s.
pub(super) const fn sample_point_ps(bit_ps: u64) -> u64 {
    bit_ps / 4 * 3
}

impl OwnClock {
    /// The time of the next event of this clock: the sample point, then the end of the bit.
    pub fn next_event_ps(&self) -> u64 {
        match self.latched {
            None => self.start_ps + sample_point_ps(self.bit_ps),
            Some(_) => self.start_ps + self.bit_ps,
        }
    }

    /// Begins the next bit.
    pub fn begin_bit(&mut self) {
        self.start_ps += self.bit_ps;
        self.latched = None;
    }

    /// Advances to the bit that contains `to_ps`, on an idle wire. Returns the number of bits
    /// passed.
    pub fn skip_idle(&mut self, to_ps: u64) -> u64 {
        let bits = to_ps.saturating_sub(self.start_ps) / self.bit_ps;
        self.start_ps += bits * self.bit_ps;
        let sampled = self.start_ps + sample_point_ps(self.bit_ps) < to_ps;
        self.latched = sampled.then_some(Level::Recessive);
        bits
    }
}

/// One station and its cable.
pub(super) struct Port {
    pub name: String,
    pub station: StationRef,
    /// False if the cable is disconnected and the station receives only itself.
    pub connected: bool,
    /// True while it misses a frame: it is not stepped until the frame ends.
    pub misses_frame: bool,
    /// True if the others do not receive it until the bus is idle, which it does not notice. See
    /// [`Fault::NoAck`](super::Fault::NoAck).
    pub is_muted: bool,
    /// The bit time from which `pace` was derived.
    bit_time_ps: Option<u64>,
    pub pace: Pace,
    /// Its level in the current bit.
    pub driven: Level,
}

impl Port {
    pub fn new(name: &str, station: StationRef) -> Port {
        Port {
            name: name.to_owned(),
            station,
            connected: true,
            misses_frame: false,
            is_muted: false,
            bit_time_ps: None,
            pace: Pace::Off,
            driven: Level::Recessive,
        }
    }

    /// Applies a change of the station's bit time. Returns true if there was one.
    pub fn update_pace(&mut self, bus_bit_ps: u64, now: Cycles) -> bool {
        let bit_time_ps = self.station.borrow().bit_time_ps();
        if bit_time_ps == self.bit_time_ps {
            return false;
        }
        self.bit_time_ps = bit_time_ps;
        self.driven = Level::Recessive;
        self.pace = match bit_time_ps {
            None => Pace::Off,
            Some(ps) if ps.abs_diff(bus_bit_ps) * 1_000_000 <= bus_bit_ps * IN_STEP_PPM => {
                Pace::InStep
            }
            Some(ps) => {
                assert!(ps >= 4, "a bit time of {ps} ps");
                let start_ps = now * PS_PER_CYCLE;
                Pace::Own(OwnClock { bit_ps: ps, start_ps, latched: None })
            }
        };
        true
    }

    /// True if it is stepped with the bus's bits and does not miss a frame.
    pub fn is_in_step(&self) -> bool {
        self.pace == Pace::InStep && !self.misses_frame
    }

    /// True if the others receive what it drives.
    pub fn is_heard(&self) -> bool {
        self.connected && !self.misses_frame && !self.is_muted
    }
}
