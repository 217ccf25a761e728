//! Converts commands to the width of the servo pulse.

use dronecan_wire::float16;

use super::parameters::{OutputParameter, Parameters};

/// Width of a pulse in ticks of half a microsecond, the unit of the timer; 0 is no pulse.
pub type Ticks = u16;

/// The unit of a command's value (DSDL uavcan/equipment/actuator/Command.uavcan).
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
    /// The type with this number. `None` for a force, a speed, or an undefined type.
    pub fn new(raw: u8) -> Option<Self> {
        Some(match raw {
            0 => Self::Unitless,
            1 => Self::Position,
            4 => Self::Pwm,
            _ => return None,
        })
    }

    /// Fractional bits of the value that [`Travel::pulse`] takes.
    pub fn fraction_bits(self) -> u8 {
        match self {
            Self::Unitless => 14,
            Self::Position => 12,
            Self::Pwm => 1,
        }
    }
}

/// The outputs of the board, which make the pulses.
pub trait Output {
    /// Sets the width of an output's pulse from the next period on; 0 ends the pulses. Does not cut
    /// a pulse that has begun, so the pulses end at the first call between two pulses.
    fn set(&mut self, output: usize, width: Ticks);

    /// Ends a group of calls of [`set`](Self::set), whose pulses begin in the same period.
    #[inline(always)]
    fn commit(&mut self) {}
}

/// 4096 x pi / 360 x 65,536. Converts the whole travel in degrees to half of it in 4096ths of a
/// radian, times 65,536.
const HALF_RANGE_FACTOR: u32 = 2_342_530;

/// The travel that the parameters define.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Travel {
    /// The pulse for no deflection.
    trim: Ticks,
    /// Distance from the trim to the lower end, and to the upper end.
    below: Ticks,
    above: Ticks,
    is_reversed: bool,
    /// Half the travel, in 4096ths of a radian.
    half_range: u16,
}

impl Travel {
    /// No travel.
    pub const NONE: Self = Self { trim: 0, below: 0, above: 0, is_reversed: false, half_range: 0 };

    /// Applies the parameters. Accepts OUTn_MIN and OUTn_MAX in either order, and clamps OUTn_TRIM
    /// between them, because the bus sets one parameter at a time.
    #[inline(never)]
    pub fn update(&mut self, output: usize, parameters: &Parameters) {
        let mut low = parameters.of(output, OutputParameter::Min) << 1;
        let mut high = parameters.of(output, OutputParameter::Max) << 1;
        if high < low {
            core::mem::swap(&mut low, &mut high);
        }
        let trim = (parameters.of(output, OutputParameter::Trim) << 1).clamp(low, high);
        self.trim = trim;
        self.below = trim - low;
        self.above = high - trim;
        self.is_reversed = parameters.of(output, OutputParameter::Reversed) as u8 != 0;
        let range_deg = u32::from(parameters.of(output, OutputParameter::Range));
        self.half_range = ((range_deg * HALF_RANGE_FACTOR + (1 << 15)) >> 16) as u16;
    }

    /// The pulse for no deflection.
    pub fn trim(&self) -> Ticks {
        self.trim
    }

    /// Distance from the trim to one end.
    #[inline(always)]
    fn side(&self, is_low: bool) -> Ticks {
        if is_low { self.below } else { self.above }
    }

    fn low(&self) -> Ticks {
        self.trim - self.below
    }

    /// Clamps a pulse to the travel.
    #[inline(never)]
    pub fn limit(&self, ticks: Ticks) -> Ticks {
        let (low, high) = (self.low(), self.trim + self.above);
        if ticks < low {
            low
        } else if ticks > high {
            high
        } else {
            ticks
        }
    }

    /// The pulse for a command; 0 for a width of zero or less. A command beyond the travel gets the
    /// end of the travel.
    ///
    /// OUTn_REVERSED reverses unitless and position commands, but not a width.
    pub fn pulse(&self, command: CommandType, value: i16) -> Ticks {
        let mut is_low = value < 0;
        let magnitude = value.unsigned_abs();
        if command == CommandType::Pwm {
            return if is_low || value == 0 { 0 } else { self.limit(magnitude) };
        }
        is_low ^= self.is_reversed;
        let side = self.side(is_low);
        let offset = if command == CommandType::Unitless {
            // Divides by 2^14, rounded.
            ((u32::from(magnitude) * u32::from(side << 2) + (1 << 15)) >> 16) as u16
        } else {
            scaled(magnitude, side, self.half_range)
        };
        // Limits a command beyond the travel to the end.
        let offset = offset.min(side);
        if is_low { self.trim - offset } else { self.trim + offset }
    }

    /// The pulse that stops a motor: the lower end of the travel.
    #[cfg(feature = "outputs")]
    pub fn motor_off(&self) -> Ticks {
        self.low()
    }

    /// The pulse for a motor's command: up to 8191, which is the upper end of the travel. 0 and
    /// less stop it.
    #[cfg(feature = "outputs")]
    pub fn pulse_of_throttle(&self, throttle: i16) -> Ticks {
        let span = self.below + self.above;
        // Divides by 2^13, rounded.
        self.low()
            + ((u32::from(throttle.max(0) as u16) * u32::from(span) + (1 << 12)) >> 13) as u16
    }

    /// The pulse for a position of the thesis's command: 0 to 255 over the full travel.
    #[inline(always)]
    pub fn pulse_of_byte(&self, mut position: u8) -> Ticks {
        if self.is_reversed {
            position = !position;
        }
        let [low, high] = (self.below + self.above).to_le_bytes();
        // The product of 24 bits is 256 x `product` + `rest`. It is computed byte by byte, because
        // the AVR multiplies bytes.
        let [rest, carry] = (u16::from(position) * u16::from(low)).to_le_bytes();
        let product = u16::from(position) * u16::from(high) + u16::from(carry);
        // Divides by 255: 1/255 is nearly 1/256 + 1/65,536.
        self.low() + product + ((product + u16::from(rest) + (1 << 7)) >> 8)
    }

    /// The position of a pulse, in radians as a float16. A command of that position gives the pulse
    /// again.
    #[inline(always)]
    pub fn position(&self, pulse: Ticks) -> u16 {
        let is_low = pulse < self.trim;
        let offset = pulse.abs_diff(self.trim);
        let position = float16::from_fixed(scaled(offset, self.half_range, self.side(is_low)), 12);
        if is_low ^ self.is_reversed { position | float16::SIGN } else { position }
    }
}

/// `value` x `factor` / `divisor`, rounded, and limited to 16 bits; 0 for a divisor of 0. The
/// divisor is at most 32,767.
///
/// Divides bit by bit. Divisor and quotient have only 16 bits, so it takes half as long as a
/// division of 32 bits.
#[inline(never)]
pub fn scaled(value: u16, factor: u16, divisor: u16) -> u16 {
    if divisor == 0 {
        return 0;
    }
    // The upper half is the rest. The lower half shifts the dividend out and the quotient in.
    let mut rest_and_quotient = u32::from(value) * u32::from(factor) + u32::from(divisor >> 1);
    if (rest_and_quotient >> 16) as u16 >= divisor {
        return u16::MAX;
    }
    for _ in 0..16u8 {
        rest_and_quotient <<= 1;
        if (rest_and_quotient >> 16) as u16 >= divisor {
            rest_and_quotient -= u32::from(divisor) << 16;
            rest_and_quotient |= 1;
        }
    }
    rest_and_quotient as u16
}

#[cfg(test)]
mod tests;
