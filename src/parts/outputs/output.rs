//! What an output of any kind has: its entry, its travel and its pulse.

use dronecan_wire::{Slot, float16};

use super::command::Command;
use super::travel::{CommandType, Ticks, Travel};
use crate::tables::parameters::Parameters;

/// The slot of an output that follows no ArrayCommand. (All bytes are 0, so that the outputs need
/// no initial values in flash.)
pub const NO_SLOT: Slot = Slot { at: 0, bits: 0 };

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
    /// It will expect commands again once the safety switch is off.
    pub is_to_resume: bool,
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
        is_to_resume: false,
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
    pub fn position(&self) -> u16 {
        if self.pulse == 0 { float16::NAN } else { self.travel.position(self.pulse) }
    }

    /// True if a command was followed within the last `time_ms`, or up to a millisecond before.
    pub fn has_followed_within(&self, time_ms: u16, now_ms: u16) -> bool {
        self.is_following && now_ms.wrapping_sub(self.followed_ms) <= time_ms
    }

    /// True if no command was followed for this time, and up to a millisecond longer: the command
    /// may have come at the end of its millisecond. 0 is for ever.
    pub fn is_late(&self, timeout_ms: u16, now_ms: u16) -> bool {
        timeout_ms != 0 && now_ms.wrapping_sub(self.followed_ms) > timeout_ms
    }

    /// Follows the entry. `pulse` tells the pulse for its type and its value in fixed point.
    /// Returns the pulse and that value.
    pub fn follow(
        &mut self,
        now_ms: u16,
        pulse: impl FnOnce(&Travel, CommandType, i16) -> Ticks,
    ) -> (Ticks, i16) {
        let Command { unit, value, .. } = self.entry;
        let value = unit.fixed(u16::from_le_bytes(value));
        self.pulse = pulse(&self.travel, unit, value);
        self.is_following = true;
        self.followed_ms = now_ms;
        (self.pulse, value)
    }

    /// Follows no command until the next one.
    pub fn stop_following(&mut self) {
        self.is_following = false;
    }

    /// Sets the width of the pulse; 0 ends the pulses.
    pub fn set_pulse(&mut self, pulse: Ticks) {
        self.pulse = pulse;
    }

    /// The travel.
    pub fn travel(&self) -> &Travel {
        &self.travel
    }

    /// The output gets another type or ID: ends the pulses until a command for these comes.
    pub fn end(&mut self) {
        self.is_following = false;
        self.is_to_resume = false;
        self.pulse = 0;
    }

    /// The safety switch is off: if commands were expected before, they are from now on, and the
    /// failsafe begins if none comes.
    pub fn resume(&mut self, now_ms: u16) {
        if core::mem::take(&mut self.is_to_resume) {
            self.is_following = true;
            self.followed_ms = now_ms;
        }
    }
}
