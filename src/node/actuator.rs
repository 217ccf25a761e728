//! The servo output: which commands it follows, when the vehicle has to be armed for that, and where it goes when commands stop.

use super::parameters::{Parameter, Parameters};
use super::servo::{CommandType, Output, Ticks, Travel};
use crate::dronecan::float16;
use crate::dronecan::receive::Transfer;
use crate::monitor::{Event, Line};

/// ArmingStatus comes twice a second from ArduPilot; in the course of so many seconds without one the vehicle counts as disarmed.
#[cfg(feature = "standard")]
const ARMING_TIMEOUT_S: u8 = 4;

/// OUT1_FS: what the output does when commands stop. 3 ends the pulses.
mod failsafe {
    /// Keeps the pulse.
    pub const HOLD: u8 = 0;
    /// Goes to OUT1_TRIM.
    pub const TRIM: u8 = 1;
    /// Goes to OUT1_FS_PWM.
    pub const PWM: u8 = 2;
}

/// The servo output.
pub struct Actuator {
    travel: Travel,
    pulse: Ticks,
    /// A command was followed, and none has been missing since.
    is_following: bool,
    /// When the last command was followed.
    followed_ms: u16,
    /// There have been commands since that were not followed.
    hears_commands: bool,
    /// Seconds that the vehicle still counts as armed.
    armed_s: u8,
}

impl Actuator {
    /// Without a pulse.
    pub const fn new() -> Self {
        Self { travel: Travel::NONE, pulse: 0, is_following: false, followed_ms: 0, hears_commands: false, armed_s: 0 }
    }

    /// Takes over the parameters of the travel.
    pub fn update(&mut self, parameters: &Parameters) {
        self.travel.update(parameters);
    }

    /// Width of the pulse; 0 for none.
    pub fn pulse(&self) -> Ticks {
        self.pulse
    }

    /// A command was followed, and none has been missing since.
    pub fn is_following(&self) -> bool {
        self.is_following
    }

    /// No command came since the last one that was followed, not even for others.
    pub fn hears_nothing(&self) -> bool {
        !self.hears_commands
    }

    /// The position that the pulse asks for, in radians as a float16; not a number without a pulse.
    #[inline(always)]
    pub fn position(&self) -> u16 {
        if self.pulse == 0 { float16::NAN } else { self.travel.position(self.pulse) }
    }

    /// ARM_REQ asks for an armed vehicle, and it is not.
    #[inline(never)]
    pub fn is_disarmed(&self, parameters: &Parameters) -> bool {
        #[cfg(feature = "standard")]
        return self.armed_s == 0 && parameters.is_on(Parameter::ArmReq);
        #[cfg(not(feature = "standard"))]
        return {
            let _ = parameters;
            false
        };
    }

    /// Takes an ArmingStatus.
    #[cfg(feature = "standard")]
    #[inline(always)]
    pub fn arm(&mut self, status: u8) {
        const FULLY_ARMED: u8 = 255;
        self.armed_s = if status == FULLY_ARMED { ARMING_TIMEOUT_S } else { 0 };
    }

    /// Takes an ArrayCommand: its entry for this output, if there is one.
    #[inline(always)]
    pub fn take_array_command(
        &mut self,
        command: &Transfer,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        servo: &mut impl Output,
    ) -> Line {
        self.hears_commands = true;
        let &[_, b1, b2, b3, ..] = command.bytes();
        if command.len() == 0 {
            return Line::CommandElsewhere;
        }
        // The draft has no type.
        #[cfg(feature = "draft")]
        if command.len() == 3 {
            let value = u16::from_le_bytes([b1, b2]);
            return self.take_command(CommandType::Unitless as u8, value, event, now_ms, parameters, servo);
        }
        self.take_command(b1, u16::from_le_bytes([b2, b3]), event, now_ms, parameters, servo)
    }

    /// Takes a command for this output: a command type, and its value as a float16.
    #[inline(always)]
    fn take_command(
        &mut self,
        unit: u8,
        value: u16,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        servo: &mut impl Output,
    ) -> Line {
        let Some(unit) = CommandType::new(unit) else { return Line::RefusedType };
        if !float16::is_finite(value) {
            return Line::RefusedValue;
        }
        let value = float16::to_fixed(value, unit.fraction_bits());
        let pulse = self.travel.pulse(unit, value);
        if pulse == 0 {
            return Line::RefusedValue;
        }
        // What is logged are microseconds, of two halves, or thousandths: of 2^14, and of 2^12 to a radian.
        event.a = (value >> 1) as u16;
        let (line, scale) = match unit {
            CommandType::Unitless => (Line::CommandUnitless, 4000),
            CommandType::Position => (Line::CommandPosition, 16_000),
            CommandType::Pwm => return self.follow(pulse, Line::CommandPwm, event, now_ms, parameters, servo),
        };
        event.a = ((i32::from(value) * scale) >> 16) as u16;
        self.follow(pulse, line, event, now_ms, parameters, servo)
    }

    /// Takes the thesis's command: 0 to 255 over the full travel.
    #[inline(always)]
    pub fn take_servo_command(
        &mut self,
        position: u8,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        servo: &mut impl Output,
    ) -> Line {
        let pulse = self.travel.pulse_of_byte(position);
        self.follow(pulse, Line::CommandThesis, event, now_ms, parameters, servo)
    }

    /// Sets a pulse, unless the vehicle must be armed for that.
    #[inline(never)]
    fn follow(
        &mut self,
        pulse: Ticks,
        line: Line,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        servo: &mut impl Output,
    ) -> Line {
        #[cfg(feature = "standard")]
        if self.is_disarmed(parameters) {
            return Line::RefusedDisarmed;
        }
        let _ = parameters;
        servo.set(pulse);
        self.pulse = pulse;
        self.is_following = true;
        self.hears_commands = false;
        self.followed_ms = now_ms;
        event.b = pulse;
        line
    }

    /// To be called once a millisecond. Whether the failsafe has begun, because no command was followed for OUT1_TIMEOUT.
    #[inline(always)]
    pub fn tick(&mut self, now_ms: u16, parameters: &Parameters) -> bool {
        if !self.is_following {
            return false;
        }
        let timeout_ms = parameters.get(Parameter::Out1Timeout);
        let is_late = timeout_ms != 0 && now_ms.wrapping_sub(self.followed_ms) >= timeout_ms;
        if is_late || self.is_disarmed(parameters) {
            self.fail_safe(parameters);
        }
        is_late
    }

    /// Goes where OUT1_FS says, until the next command.
    #[inline(never)]
    pub fn fail_safe(&mut self, parameters: &Parameters) {
        self.is_following = false;
        self.pulse = match parameters.get(Parameter::Out1Fs) as u8 {
            failsafe::HOLD => return,
            failsafe::TRIM => self.travel.trim(),
            failsafe::PWM => self.travel.limit(parameters.get(Parameter::Out1FsPwm) << 1),
            _ => 0,
        };
    }

    /// To be called once a second.
    #[inline(always)]
    pub fn second(&mut self) {
        self.armed_s = self.armed_s.saturating_sub(1);
    }
}

impl Default for Actuator {
    fn default() -> Self {
        Self::new()
    }
}
