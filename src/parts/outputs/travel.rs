//! Converts commands to the width of the servo pulse.

use dronecan_wire::float16;

use crate::math::scaled;
use crate::monitor::Line;
use crate::tables::parameters::{OutputParameter, Parameters};

/// Width of a pulse in ticks of half a microsecond, the unit of the timer; 0 is no pulse.
pub type Ticks = u16;

/// The line of a command has the value.
const HAS_VALUES: bool = cfg!(feature = "values");

/// The unit of a command's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum CommandType {
    /// -1 to 1 over the travel (DSDL uavcan/equipment/actuator/Command.uavcan).
    Unitless = 0,
    /// Radians from the trim (the same).
    Position = 1,
    /// Width of the pulse in microseconds (the same).
    Pwm = 4,
    /// 0 to 255 over the full travel (tests/clients/dsdl/thesis/ServoCommand).
    Byte,
    /// 0 to 8191 over the full travel; less than 0 is 0 (DSDL
    /// uavcan/equipment/esc/1030.RawCommand.uavcan).
    Throttle,
}

impl CommandType {
    /// The type of an actuator.Command with this number. `high` is the higher byte of its value, a
    /// float16. The line for the reason of a refusal if the type is a force, a speed or undefined,
    /// or if the value gives no pulse.
    #[inline(always)]
    pub fn checked(number: u8, high: u8) -> Result<Self, Line> {
        /// 0.25, of which the lower byte is 0. Less is rounded to a width of 0.
        const LEAST_WIDTH: i8 = 0x34;
        let unit = match number {
            0 => Self::Unitless,
            1 => Self::Position,
            4 if high as i8 >= LEAST_WIDTH => Self::Pwm,
            4 => return Err(Line::RefusedValue),
            _ => return Err(Line::RefusedType),
        };
        if float16::is_finite(u16::from(high) << 8) { Ok(unit) } else { Err(Line::RefusedValue) }
    }

    /// The value in fixed point: a float16 with 14, 12 or 1 fractional bits, or the number itself.
    pub fn fixed(self, value: u16) -> i16 {
        let fraction_bits = match self {
            Self::Unitless => 14,
            Self::Position => 12,
            Self::Pwm => 1,
            Self::Byte | Self::Throttle => return value as i16,
        };
        float16::to_fixed(value, fraction_bits)
    }

    /// The line to log when a command is followed.
    pub fn line(self) -> Line {
        match self {
            Self::Byte => Line::CommandThesis,
            Self::Throttle => Line::RawCommand,
            _ if !HAS_VALUES => Line::Command,
            Self::Unitless => Line::CommandUnitless,
            Self::Position => Line::CommandPosition,
            Self::Pwm => Line::CommandPwm,
        }
    }

    /// The value for the line: microseconds, thousandths, or the number itself. A line without the
    /// value takes any.
    pub fn logged(self, fixed: i16) -> u16 {
        let mut logged = fixed;
        if !HAS_VALUES {
            return fixed as u16;
        }
        if matches!(self, Self::Unitless | Self::Position) {
            logged >>= if self == Self::Unitless { 4 } else { 2 };
            // Converts 1024ths to thousandths: 1 - 3/128 is 1000/1024. No product overflows.
            logged -= (logged * 3) >> 7;
        } else if self == Self::Pwm {
            logged >>= 1;
        }
        logged as u16
    }
}

/// 4096 x pi / 360 as a fraction, with 355 / 113 for pi. Converts the whole travel in degrees to
/// half of it in 4096ths of a radian.
const HALF_RANGE: (u16, u16) = (36_352, 1017);

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
        let range_deg = parameters.of(output, OutputParameter::Range);
        self.half_range = scaled(range_deg, HALF_RANGE.0, HALF_RANGE.1);
    }

    /// The pulse for no deflection.
    pub fn trim(&self) -> Ticks {
        self.trim
    }

    /// Distance from the trim to one end.
    fn side(&self, is_low: bool) -> Ticks {
        if is_low { self.below } else { self.above }
    }

    /// The lower end of the travel, which stops a motor.
    pub fn low(&self) -> Ticks {
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

    /// The pulse for a command, whose value is [`CommandType::fixed`]. A command beyond the travel
    /// gets the end of the travel.
    ///
    /// OUTn_REVERSED reverses all commands but a width and a throttle.
    #[inline(always)]
    pub fn pulse(&self, unit: CommandType, value: i16) -> Ticks {
        if unit == CommandType::Byte {
            return self.pulse_of_byte(value as u8);
        }
        let mut is_low = value < 0;
        let magnitude = value.unsigned_abs();
        if unit == CommandType::Pwm {
            return self.limit(magnitude);
        }
        is_low ^= self.is_reversed;
        let side = self.side(is_low);
        let offset = if unit == CommandType::Unitless {
            // Divides by 2^14, rounded.
            ((u32::from(magnitude) * u32::from(side << 2) + (1 << 15)) >> 16) as u16
        } else {
            scaled(magnitude, side, self.half_range)
        };
        // Limits a command beyond the travel to the end.
        let offset = offset.min(side);
        if is_low { self.trim - offset } else { self.trim + offset }
    }

    /// The pulse for a motor's command: up to 8191, which is the upper end of the travel. 0 and
    /// less stop it.
    pub fn pulse_of_throttle(&self, throttle: i16) -> Ticks {
        let span = self.below + self.above;
        // Divides by 2^13, rounded.
        self.low()
            + ((u32::from(throttle.max(0) as u16) * u32::from(span) + (1 << 12)) >> 13) as u16
    }

    /// The pulse for a position of the thesis's command: 0 to 255 over the full travel.
    fn pulse_of_byte(&self, mut position: u8) -> Ticks {
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

#[cfg(test)]
mod tests;
