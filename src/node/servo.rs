//! From commands to the width of the servo pulse.

use core::sync::atomic::{Ordering, compiler_fence};

use super::parameters::{Parameter, Parameters};
use crate::dronecan::float16;

/// Width of a pulse in ticks of half a microsecond, the unit of the timer that makes it; 0 is no pulse.
pub type Ticks = u16;

/// What a command's value means (DSDL uavcan/equipment/actuator/Command.uavcan).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum CommandType {
    /// -1 to 1 over the travel.
    Unitless = 0,
    /// Radians from the trim.
    Position = 1,
    /// Width of the pulse in microseconds.
    Pwm = 4,
}

impl CommandType {
    /// `None` for a force, a speed, or a type that nobody has defined.
    pub fn new(raw: u8) -> Option<Self> {
        Some(match raw {
            0 => Self::Unitless,
            1 => Self::Position,
            4 => Self::Pwm,
            _ => return None,
        })
    }

    /// Binary places of the value that [`Travel::pulse`] takes.
    pub fn fraction_bits(self) -> u8 {
        match self {
            Self::Unitless => 14,
            Self::Position => 12,
            Self::Pwm => 1,
        }
    }
}

/// What makes the pulses.
pub trait Output {
    /// The width from the next period on; 0 ends the pulses. A pulse that has begun is not cut, so to end them takes until
    /// it is called between two.
    fn set(&mut self, width: Ticks);
}

/// One, as a unitless value.
const ONE: u16 = 1 << 14;

/// From degrees of the whole travel to 4096ths of a radian of half of it: times this, by 65,536. 4096 x pi / 360 x 65,536.
const HALF_RANGE_FACTOR: u32 = 2_342_530;

/// The way from the trim to one end of the travel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Side {
    ticks: Ticks,
    /// Ticks for 16 radians; or [`UNKNOWN`](Self::UNKNOWN).
    gain: u16,
}

impl Side {
    const NONE: Self = Self { ticks: 0, gain: Self::UNKNOWN };

    /// A gain that is not worked out yet, or is larger than there is room for: then a position takes a division.
    const UNKNOWN: u16 = 0;
}

/// The travel, as the parameters have it now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Travel {
    /// The middle, for no deflection.
    pub trim: Ticks,
    below: Side,
    above: Side,
    is_reversed: bool,
    /// Half the travel, in 4096ths of a radian.
    half_range: u16,
}

impl Travel {
    /// None at all.
    pub const NONE: Self = Self { trim: 0, below: Side::NONE, above: Side::NONE, is_reversed: false, half_range: 0 };

    /// Takes over the parameters. OUT1_MIN and OUT1_MAX may be in either order, and OUT1_TRIM is taken to be between them:
    /// parameters are set one at a time.
    #[inline(never)]
    pub fn update(&mut self, parameters: &Parameters) {
        let mut low = parameters.get(Parameter::Out1Min) << 1;
        let mut high = parameters.get(Parameter::Out1Max) << 1;
        if high < low {
            core::mem::swap(&mut low, &mut high);
        }
        let trim = (parameters.get(Parameter::Out1Trim) << 1).clamp(low, high);
        self.trim = trim;
        // Their gains follow, in turns of their own: until then the old ones count, within the new travel.
        self.below.ticks = trim.wrapping_sub(low);
        self.above.ticks = high.wrapping_sub(trim);
        self.is_reversed = parameters.is_on(Parameter::Out1Reversed);
        let range_deg = u32::from(parameters.get(Parameter::Out1Range));
        self.half_range = (range_deg.wrapping_mul(HALF_RANGE_FACTOR).wrapping_add(1 << 15) >> 16) as u16;
    }

    /// Works out the gain of one side, after [`update`](Self::update). A division takes 300 cycles, for which a command should not have
    /// to wait.
    #[inline(never)]
    pub fn work_out(&mut self, is_low: bool) {
        let half_range = self.half_range;
        let side = if is_low { &mut self.below } else { &mut self.above };
        let gain = scaled(side.ticks, u16::MAX, half_range);
        side.gain = if gain == u16::MAX { Side::UNKNOWN } else { gain };
    }

    #[inline(always)]
    fn side(&self, is_low: bool) -> &Side {
        if is_low { &self.below } else { &self.above }
    }

    fn low(&self) -> Ticks {
        self.trim.wrapping_sub(self.below.ticks)
    }

    /// The nearest within the travel.
    #[inline(never)]
    pub fn limit(&self, ticks: Ticks) -> Ticks {
        let (low, high) = (self.low(), self.trim.wrapping_add(self.above.ticks));
        if ticks < low {
            low
        } else if ticks > high {
            high
        } else {
            ticks
        }
    }

    /// The pulse for a command; 0 if it asks for none, with a width of zero or less. Whatever asks for more than the travel
    /// gets the end of it.
    ///
    /// A width is taken as it is; the other two are turned around by OUT1_REVERSED.
    #[inline(never)]
    pub fn pulse(&self, command: CommandType, value: i16) -> Ticks {
        let mut is_low = value < 0;
        let magnitude = value.unsigned_abs();
        if command == CommandType::Pwm {
            return if is_low || value == 0 { 0 } else { self.limit(magnitude) };
        }
        is_low ^= self.is_reversed;
        let side = self.side(is_low);
        let (full, gain) = if command == CommandType::Unitless {
            // Of a product by 2^14 and one by 2^2 the upper half is one by 2^14.
            (ONE, side.ticks << 2)
        } else {
            (self.half_range, side.gain)
        };
        let offset =
            if gain == Side::UNKNOWN { scaled(magnitude, side.ticks, full) } else { upper_half(magnitude, gain) };
        // Whatever asks for more gets the end.
        let offset = offset.min(side.ticks);
        if is_low { self.trim.wrapping_sub(offset) } else { self.trim.wrapping_add(offset) }
    }

    /// The pulse for a position of the thesis's command: 0 to 255 over the full travel.
    #[inline(never)]
    pub fn pulse_of_byte(&self, mut position: u8) -> Ticks {
        if self.is_reversed {
            position = !position;
        }
        // The product by 256, and what is left of it: two multiplications of bytes are a quarter of one of words.
        let [low, high] = self.below.ticks.wrapping_add(self.above.ticks).to_le_bytes();
        let position = u16::from(position);
        let [rest, carry] = position.wrapping_mul(u16::from(low)).to_le_bytes();
        let by_256 = position.wrapping_mul(u16::from(high)).wrapping_add(u16::from(carry));
        // By 255, which is 256 less a 256th: right to a sixteenth of a tick.
        let more = by_256.wrapping_add(u16::from(rest)).wrapping_add(128) >> 8;
        self.low().wrapping_add(by_256).wrapping_add(more)
    }

    /// The position that a pulse asks for, as an equal command would have it: in 4096ths of a radian, with the sign in the highest bit
    /// (see [`radians`]).
    #[inline(never)]
    pub fn position(&self, pulse: Ticks) -> u16 {
        let is_low = pulse < self.trim;
        let offset = if is_low { self.trim.wrapping_sub(pulse) } else { pulse.wrapping_sub(self.trim) };
        let side = self.side(is_low).ticks;
        let position = scaled(offset, self.half_range, side) & !float16::SIGN;
        if is_low ^ self.is_reversed { position | float16::SIGN } else { position }
    }
}

/// A [position](Travel::position) as a float16.
#[inline(always)]
pub fn radians(position: u16) -> u16 {
    float16::from_fixed(position & !float16::SIGN, 12) | position & float16::SIGN
}

/// `a` x `b` / 65,536, rounded: four multiplications of bytes, where one of words, for which there is a function, is twice as long.
#[inline(never)]
fn upper_half(a: u16, b: u16) -> u16 {
    let product = |a: u8, b: u8| u16::from(a).wrapping_mul(u16::from(b));
    let ([a0, a1], [b0, b1]) = (a.to_le_bytes(), b.to_le_bytes());
    let [_, carry] = product(a0, b0).to_le_bytes();
    let [middle, upper] = product(a1, b0).wrapping_add(u16::from(carry)).to_le_bytes();
    let [_, more] = product(a0, b1).wrapping_add(u16::from(middle)).wrapping_add(1 << 7).to_le_bytes();
    product(a1, b1).wrapping_add(u16::from(upper)).wrapping_add(u16::from(more))
}

/// `value` x `factor` / `divisor`, rounded, and limited to 16 bits; 0 for a divisor of 0. The divisor is at most 32,767.
///
/// Divides bit by bit. As the divisor and the quotient have only 16 that takes half as long as a division of 32 bits.
#[inline(never)]
pub fn scaled(value: u16, factor: u16, divisor: u16) -> u16 {
    if value == 0 || divisor == 0 {
        return 0;
    }
    let product = u32::from(value).wrapping_mul(u32::from(factor)).wrapping_add(u32::from(divisor >> 1));
    let mut rest = (product >> 16) as u16;
    if rest >= divisor {
        return u16::MAX;
    }
    // The quotient comes in at the bottom as the rest goes out at the top.
    let mut quotient = product as u16;
    let mut bits = 16u8;
    while bits != 0 {
        rest <<= 1;
        // The fences make the compiler branch once, where it would choose each half by a comparison of its own, or shift by 15.
        if quotient & 1 << 15 != 0 {
            compiler_fence(Ordering::SeqCst);
            rest |= 1;
        }
        quotient <<= 1;
        if rest >= divisor {
            compiler_fence(Ordering::SeqCst);
            rest = rest.wrapping_sub(divisor);
            quotient |= 1;
        }
        bits = bits.wrapping_sub(1);
    }
    quotient
}

#[cfg(test)]
mod tests;
