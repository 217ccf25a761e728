//! Random values of commands, each with the pulse that it asks for. The outputs have the default
//! travel: 1000 to 2000 us, trim 1500 us, 90 degrees.

use std::collections::VecDeque;
use std::f32::consts::FRAC_PI_4;

use bench::Noise;

use super::setup::Escs;

/// Commands of an output in a row that ask for different pulses, and the least difference between
/// two of them, in ticks of half a microsecond. A pulse may be off by two.
const DISTINCT: (usize, i32) = (40, 5);
/// The same for OneShot125, where an eighth of a pulse may be off by one.
const DISTINCT_EIGHTHS: (usize, i32) = (20, 30);

/// The unit of an entry of ArrayCommand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// -1 to 1 over the travel.
    Unitless = 0,
    /// Radians from the trim.
    Position = 1,
    /// Width of the pulse in microseconds.
    Width = 4,
}

impl Unit {
    /// All units that the node follows.
    pub const ALL: [Unit; 3] = [Unit::Unitless, Unit::Position, Unit::Width];
}

/// The pulse of a motor that is stopped, in ticks of half a microsecond.
pub const STOPPED: i32 = 2000;

/// The pulse of a width in microseconds, in ticks of half a microsecond.
fn ticks(width_us: f32) -> i32 {
    (width_us * 2.0).round() as i32
}

/// The pulse for a deflection of -1 to 1; one beyond that gets the end of the travel.
fn deflected(deflection: f32) -> i32 {
    ticks(1500.0 + 500.0 * deflection.clamp(-1.0, 1.0))
}

/// A random value of an entry, as a float16, and the pulse that it asks for in ticks. Most are
/// evenly distributed over the travel and a little beyond; one in eight is any finite value.
fn entry(unit: Unit, random: &mut Noise) -> ([u8; 2], i32) {
    let even = random.below(1 << 20) as f32 / (1 << 19) as f32 - 1.0;
    let value = match unit {
        _ if random.below(8) == 0 => any_finite(unit, random),
        Unit::Unitless => half::f16::from_f32(even * 1.05),
        Unit::Position => half::f16::from_f32(even * 0.85),
        Unit::Width => half::f16::from_f32(1500.0 + even * 550.0),
    };
    let exact = value.to_f32();
    let pulse = match unit {
        Unit::Unitless => deflected(exact),
        Unit::Position => deflected(exact / FRAC_PI_4),
        Unit::Width => ticks(exact.clamp(1000.0, 2000.0)),
    };
    (value.to_le_bytes(), pulse)
}

/// Any finite float16. A width is at least a microsecond, because the node rejects 0 and less.
fn any_finite(unit: Unit, random: &mut Noise) -> half::f16 {
    loop {
        let value = half::f16::from_bits(random.next_u64() as u16);
        if value.is_finite() && (unit != Unit::Width || value.to_f32() >= 1.0) {
            return value;
        }
    }
}

/// The last pulses of an output, so that each of its commands asks for another pulse than the last
/// ones: see [`DISTINCT`].
#[derive(Debug)]
pub struct Recent {
    pulses: VecDeque<i32>,
    count: usize,
    apart: i32,
}

impl Recent {
    /// No pulse yet of an output that has these pulses.
    pub fn of(escs: Escs) -> Recent {
        let (count, apart) = if escs == Escs::OneShot125 { DISTINCT_EIGHTHS } else { DISTINCT };
        Recent { pulses: VecDeque::new(), count, apart }
    }

    /// Draws until the pulse differs from the recent ones. After 100 attempts any pulse is good.
    fn distinct<T>(&mut self, mut draw: impl FnMut() -> (T, i32)) -> (T, i32) {
        let is_near = |pulse: i32, other: &i32| (other - pulse).abs() < self.apart;
        let is_recent = |pulse| self.pulses.iter().any(|other| is_near(pulse, other));
        let mut drawn = draw();
        for _ in 0..100 {
            if !is_recent(drawn.1) {
                break;
            }
            drawn = draw();
        }
        if self.pulses.len() == self.count {
            self.pulses.pop_front();
        }
        self.pulses.push_back(drawn.1);
        drawn
    }

    /// A random entry: the two bytes of its value, and its pulse in ticks.
    pub fn entry(&mut self, unit: Unit, random: &mut Noise) -> ([u8; 2], i32) {
        self.distinct(|| entry(unit, random))
    }

    /// A random byte of the thesis's command, 0 to 255 over the travel, and its pulse in ticks.
    pub fn byte(&mut self, random: &mut Noise) -> (u8, i32) {
        self.distinct(|| {
            let byte = random.next_u64() as u8;
            (byte, ticks(1000.0 + f32::from(byte) * 1000.0 / 255.0))
        })
    }

    /// A random throttle of a motor, and its pulse in ticks. One in eight is negative: it stops the
    /// motor.
    pub fn throttle(&mut self, random: &mut Noise) -> (i16, i32) {
        self.distinct(|| {
            let throttle = match random.below(8) {
                0 => -(random.below(8193) as i16),
                _ => random.below(8192) as i16,
            };
            (throttle, STOPPED + ticks(f32::from(throttle.max(0)) * 1000.0 / 8192.0))
        })
    }
}
