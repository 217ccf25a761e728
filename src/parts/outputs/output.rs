//! One output: its pulse, and what it does when commands stop.

use dronecan_wire::{Slot, float16};

use super::travel::{CommandType, Ticks, Travel};
use super::{Command, NO_SLOT};
use crate::tables::parameters::{OutputParameter, Parameter, Parameters};

/// OUTn_FS: what the output does when commands stop. 3 ends the pulses.
mod failsafe {
    /// Holds the pulse.
    pub const HOLD: u8 = 0;
    /// Goes to OUTn_TRIM.
    pub const TRIM: u8 = 1;
    /// Goes to OUTn_FS_PWM.
    pub const PWM: u8 = 2;
}

/// An output.
#[derive(Clone, Copy)]
pub struct Output {
    /// OUTn_ID.
    pub id: u8,
    /// The slot in which the receiver keeps the entry of an ArrayCommand for this output.
    pub slot: Slot,
    /// The newest valid command.
    pub entry: Command,
    travel: Travel,
    pulse: Ticks,
    /// True from a followed command until the failsafe.
    is_following: bool,
    /// Time of the last followed command, in milliseconds.
    followed_ms: u16,
    /// Node ID of its sender; 0 if there is none.
    pub commander: u8,
}

impl Output {
    /// An output that gives no pulse yet.
    pub const NONE: Self = Self {
        id: 0,
        slot: NO_SLOT,
        entry: Command { source: 0, transfer: 0, unit: CommandType::Unitless, value: [0; 2] },
        travel: Travel::NONE,
        pulse: 0,
        is_following: false,
        followed_ms: 0,
        commander: 0,
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
    pub fn has_followed_within(&self, time_ms: u16, now_ms: u16) -> bool {
        self.is_following && now_ms.wrapping_sub(self.followed_ms) < time_ms
    }

    /// Sets the pulse that the entry asks for. Returns the pulse, and the value of the entry in
    /// fixed point.
    #[inline(always)]
    pub fn follow(&mut self, now_ms: u16) -> (Ticks, i16) {
        let Command { unit, value, .. } = self.entry;
        let value = unit.fixed(u16::from_le_bytes(value));
        self.pulse = self.travel.pulse(unit, value);
        self.is_following = true;
        self.followed_ms = now_ms;
        (self.pulse, value)
    }

    /// True if no command was followed for OUTn_TIMEOUT, or by a motor for MOT_TIMEOUT.
    #[inline(always)]
    pub fn is_late(
        &self,
        output: usize,
        is_motor: bool,
        now_ms: u16,
        parameters: &Parameters,
    ) -> bool {
        let timeout_ms = if is_motor {
            parameters.get(Parameter::MotTimeout)
        } else {
            parameters.of(output, OutputParameter::Timeout)
        };
        timeout_ms != 0 && now_ms.wrapping_sub(self.followed_ms) >= timeout_ms
    }

    /// Does what OUTn_FS says, until the next command. A motor stops. An output that follows no
    /// command keeps its pulse, or has none.
    #[inline(never)]
    pub fn fail_safe(&mut self, output: usize, is_motor: bool, parameters: &Parameters) {
        if !self.is_following {
            return;
        }
        if is_motor {
            return self.stop_motor();
        }
        self.is_following = false;
        self.pulse = match parameters.of(output, OutputParameter::Fs) as u8 {
            failsafe::HOLD => return,
            failsafe::TRIM => self.travel.trim(),
            failsafe::PWM => self.travel.limit(parameters.of(output, OutputParameter::FsPwm) << 1),
            _ => 0,
        };
    }

    /// Stops a motor, until the next command. A motor that was never commanded has no pulse.
    fn stop_motor(&mut self) {
        self.is_following = false;
        if self.pulse != 0 {
            self.pulse = self.travel.low();
        }
    }

    /// A motor gets commands that it must not follow yet: gives it the pulse for no throttle.
    pub fn idle(&mut self) {
        if self.pulse == 0 {
            self.pulse = self.travel.low();
        }
    }

    /// The safety switch is on. Stops a motor. Ends the pulses of a servo if `ends_pulses`.
    pub fn begin_safe(&mut self, is_motor: bool, ends_pulses: bool) {
        self.is_following = false;
        if is_motor {
            self.stop_motor();
        } else if ends_pulses {
            self.pulse = 0;
        }
    }

    /// The output gets another type or ID: ends the pulses until a command for these comes.
    pub fn end(&mut self) {
        self.is_following = false;
        self.pulse = 0;
    }

    /// From now on commands are expected: the failsafe begins if none comes.
    pub fn expect_command(&mut self, now_ms: u16) {
        self.is_following = true;
        self.followed_ms = now_ms;
    }
}
