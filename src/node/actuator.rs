//! One output: the pulse that a command asks for, and what the output does when commands stop.

use dronecan_wire::float16;

use super::parameters::{OutputParameter, Parameters};
use super::servo::{CommandType, Ticks, Travel};
use crate::monitor::{Event, Line};

/// OUTn_FS: what the output does when commands stop. 3 ends the pulses.
mod failsafe {
    /// Holds the pulse.
    pub const HOLD: u8 = 0;
    /// Goes to OUTn_TRIM.
    pub const TRIM: u8 = 1;
    /// Goes to OUTn_FS_PWM.
    pub const PWM: u8 = 2;
}

/// Time without a command until a motor stops if OUTn_TIMEOUT disables the failsafe, in
/// milliseconds.
const MOTOR_TIMEOUT_MS: u16 = 1000;

/// An output. Outputs are numbered from 0 in the program, and from 1 in the names of parameters.
#[derive(Clone, Copy)]
pub struct Actuator {
    travel: Travel,
    pulse: Ticks,
    /// True from a followed command until the failsafe.
    is_following: bool,
    /// Time of the last followed command, in milliseconds.
    followed_ms: u16,
    /// The output was following commands, or missing them, when the safety switch was put on.
    #[cfg(feature = "safety")]
    was_following: bool,
}

impl Actuator {
    /// An output that gives no pulse yet.
    pub const NONE: Self = Self {
        travel: Travel::NONE,
        pulse: 0,
        is_following: false,
        followed_ms: 0,
        #[cfg(feature = "safety")]
        was_following: false,
    };

    /// Applies the parameters of the travel, also to the pulse.
    pub fn update(&mut self, output: usize, parameters: &Parameters) {
        self.travel.update(output, parameters);
        if self.pulse != 0 {
            self.pulse = self.travel.limit(self.pulse);
        }
    }

    /// Width of the pulse; 0 for none.
    pub fn pulse(&self) -> Ticks {
        self.pulse
    }

    /// True from a followed command until the failsafe.
    pub fn is_following(&self) -> bool {
        self.is_following
    }

    /// The position that the pulse asks for, in radians as a float16; NaN without a pulse.
    #[inline(always)]
    pub fn position(&self) -> u16 {
        if self.pulse == 0 { float16::NAN } else { self.travel.position(self.pulse) }
    }

    /// True if a command was followed less than `time_ms` ago.
    #[cfg(feature = "update")]
    pub fn has_followed_within(&self, time_ms: u16, now_ms: u16) -> bool {
        self.is_following && now_ms.wrapping_sub(self.followed_ms) < time_ms
    }

    /// The pulse for a command, a command type and its value as a float16, and the line to log; or
    /// the line for the reason of a rejection. Fills in the value for the line.
    #[inline(always)]
    pub(super) fn pulse_of_command(
        &self,
        unit: u8,
        value: u16,
        event: &mut Event,
    ) -> Result<(Ticks, Line), Line> {
        let Some(unit) = CommandType::new(unit) else { return Err(Line::RefusedType) };
        if !float16::is_finite(value) {
            return Err(Line::RefusedValue);
        }
        let value = float16::to_fixed(value, unit.fraction_bits());
        let pulse = self.travel.pulse(unit, value);
        if pulse == 0 {
            return Err(Line::RefusedValue);
        }
        // The log has microseconds for PWM (`value` has halves), and thousandths for the others:
        // `value` has 2^14 to 1, or 2^12 to a radian.
        let mut logged = value >> 1;
        let mut line = Line::CommandPwm;
        if unit != CommandType::Pwm {
            line = Line::CommandPosition;
            if unit == CommandType::Unitless {
                line = Line::CommandUnitless;
                logged >>= 2;
            }
            // Converts 1024ths to thousandths: 1 - 3/128 is 1000/1024. No product overflows.
            logged >>= 1;
            logged -= (logged * 3) >> 7;
        }
        event.a = logged as u16;
        Ok((pulse, line))
    }

    /// The pulse for the thesis's command: 0 to 255 over the full travel.
    #[inline(always)]
    pub(super) fn pulse_of_byte(&self, position: u8) -> Ticks {
        self.travel.pulse_of_byte(position)
    }

    /// The pulse for a motor's command.
    #[cfg(feature = "outputs")]
    pub(super) fn pulse_of_throttle(&self, throttle: i16) -> Ticks {
        self.travel.pulse_of_throttle(throttle)
    }

    /// Sets the pulse that a command asks for.
    #[inline(always)]
    pub(super) fn follow(&mut self, pulse: Ticks, now_ms: u16) {
        self.pulse = pulse;
        self.is_following = true;
        self.followed_ms = now_ms;
    }

    /// True if no command was followed for OUTn_TIMEOUT. A motor always has a timeout.
    #[inline(always)]
    pub(super) fn is_late(
        &self,
        output: usize,
        is_motor: bool,
        now_ms: u16,
        parameters: &Parameters,
    ) -> bool {
        let mut timeout_ms = parameters.of(output, OutputParameter::Timeout);
        if is_motor && timeout_ms == 0 {
            timeout_ms = MOTOR_TIMEOUT_MS;
        }
        timeout_ms != 0 && now_ms.wrapping_sub(self.followed_ms) >= timeout_ms
    }

    /// Does what OUTn_FS says, until the next command.
    #[inline(never)]
    pub(super) fn fail_safe(&mut self, output: usize, parameters: &Parameters) {
        self.is_following = false;
        self.pulse = match parameters.of(output, OutputParameter::Fs) as u8 {
            failsafe::HOLD => return,
            failsafe::TRIM => self.travel.trim(),
            failsafe::PWM => self.travel.limit(parameters.of(output, OutputParameter::FsPwm) << 1),
            _ => 0,
        };
    }

    /// The safety switch is put on. `is_failsafe`: commands are missing.
    #[cfg(feature = "safety")]
    pub(super) fn begin_safe(&mut self, is_failsafe: bool) {
        self.was_following = core::mem::take(&mut self.is_following) || is_failsafe;
    }

    /// Stops a motor, until the next command. A motor that was never commanded has no pulse.
    #[cfg(feature = "outputs")]
    pub(super) fn stop_motor(&mut self) {
        self.is_following = false;
        if self.pulse != 0 {
            self.pulse = self.travel.motor_off();
        }
    }

    /// Ends the pulses while the safety switch is on.
    #[cfg(feature = "safety")]
    pub(super) fn stop(&mut self) {
        self.pulse = 0;
    }

    /// From now on commands are expected again, if they were before the safety switch was put on.
    #[cfg(feature = "safety")]
    pub(super) fn end_safe(&mut self, now_ms: u16) {
        self.is_following = self.was_following;
        self.followed_ms = now_ms;
    }
}
