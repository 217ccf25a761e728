//! Outputs that are motors: they follow esc.RawCommand in place of ArrayCommand.

use dronecan_wire::esc;

use super::super::command::Command;
use super::super::kind::Kind;
use super::super::output::Output;
use super::super::travel::{CommandType, Ticks, Travel};
use crate::tables::parameters::{Parameter, Parameters};
use crate::tables::wire::{KEPT, Transfer};

/// Set in `refused_s`: this second is one of them.
const IN_THIS_SECOND: u8 = 0x80;

/// The first of these seconds may have begun before the first command.
const REFUSED_S: u8 = 3;

/// Which outputs are motors, and the newest esc.RawCommand. It is unpacked when a motor follows it:
/// a command for eight motors takes 1,000 cycles, and frames must not wait for that.
pub struct Motors {
    /// Bit n is output n.
    motors: u8,
    /// Motors whose newest command is in `payload`: bit n is output n.
    kept: u8,
    /// Node ID of its sender.
    source: u8,
    /// Its transfer ID.
    transfer: u8,
    payload: [u8; KEPT],
    /// Motors that got a command that they must not follow, and have not acted on it: bit n is
    /// output n.
    idle: u8,
    /// Seconds in which a command above idle was refused because its sender has not armed, one
    /// after the other and at most three; in the highest bit, that this second is one of them.
    refused_s: u8,
    /// Motors without a command in the last esc.RawCommand, which have not acted on it: bit n is
    /// output n.
    left_out: u8,
    /// Node ID of its sender.
    left_out_by: u8,
    /// The length of the last esc.RawCommand, and the motors for which it had a command: most are
    /// as long as the one before. 0 if the motors have changed.
    len: u8,
    commanded: u8,
}

impl Motors {
    /// No output is a motor.
    pub const fn new() -> Self {
        Self {
            motors: 0,
            kept: 0,
            source: 0,
            transfer: 0,
            payload: [0; KEPT],
            idle: 0,
            refused_s: 0,
            left_out: 0,
            left_out_by: 0,
            len: 0,
            commanded: 0,
        }
    }

    /// The motors for which an esc.RawCommand of `len` bytes has a command: bit n is output n.
    /// `indices` has the ID of each output.
    pub fn commanded(&mut self, len: u8, indices: impl Iterator<Item = u8>) -> u8 {
        if len != self.len {
            self.len = len;
            self.count(indices);
        }
        self.commanded
    }

    #[inline(never)]
    fn count(&mut self, indices: impl Iterator<Item = u8>) {
        let commands = esc::raw_commands(self.len);
        let (mut bit, mut commanded) = (1u8, 0);
        for index in indices {
            if index < commands {
                commanded |= bit;
            }
            bit <<= 1;
        }
        self.commanded = commanded & self.motors;
    }

    /// Motors for which a command is kept: bit n is output n.
    #[inline(always)]
    pub fn kept(&self) -> u8 {
        self.kept
    }

    /// Keeps an esc.RawCommand for these motors, a bit each, and for no other.
    #[inline(always)]
    pub fn keep(&mut self, command: &Transfer, motors: u8) {
        self.kept = motors;
        self.source = command.source;
        self.transfer = command.transfer_id();
        for (place, byte) in self.payload.iter_mut().zip(command.payload()) {
            *place = *byte;
        }
    }

    /// Takes note of an esc.RawCommand of this node, which has commands for the motors `found`.
    pub fn leave_out(&mut self, source: u8, found: u8) {
        self.left_out = self.motors & !found;
        self.left_out_by = source;
    }

    /// These motors, a bit each, got a command that they must not follow.
    pub fn refuse(&mut self, motors: u8) {
        self.idle |= motors;
    }

    /// Takes note of an esc.RawCommand that is refused because its sender has not armed.
    pub fn is_disarmed(&mut self, command: &Transfer) {
        if command.payload().iter().any(|&byte| byte != 0) {
            self.refused_s |= IN_THIS_SECOND;
        }
    }

    /// True if commands above idle were refused for two to three seconds, because their sender has
    /// not armed.
    pub fn are_refused(&self) -> bool {
        self.refused_s & !IN_THIS_SECOND == REFUSED_S
    }

    /// The command that is kept for a motor with this ID.
    #[inline(always)]
    pub fn kept_for(&self, index: u8) -> Option<Command> {
        let value = esc::raw_command(&self.payload, index)?;
        Some(Command {
            source: self.source,
            transfer: self.transfer,
            unit: CommandType::Throttle,
            value: value.to_le_bytes(),
        })
    }
}

impl Kind for Motors {
    fn outputs(&self) -> u8 {
        self.motors
    }

    fn update(&mut self, _n: usize, bit: u8, is_of_kind: bool, _parameters: &Parameters) {
        self.motors = if is_of_kind { self.motors | bit } else { self.motors & !bit };
        // A command for the old type or ID gives no pulse.
        self.idle &= !bit;
        // An output that is a motor no more neither follows nor misses the last esc.RawCommand.
        self.kept &= self.motors;
        self.left_out &= self.motors;
        (self.len, self.commanded) = (0, 0);
    }

    fn needs_armed(&self) -> bool {
        true
    }

    fn unpack(&mut self, bit: u8, output: &mut Output) {
        if self.kept & bit == 0 {
            return;
        }
        self.kept &= !bit;
        if let Some(command) = self.kept_for(output.id) {
            output.entry = command;
        }
    }

    fn pulse(&mut self, _bit: u8, travel: &Travel, _unit: CommandType, value: i16) -> Ticks {
        travel.pulse_of_throttle(value)
    }

    /// A motor that got a command that it must not follow has the pulse for no throttle, if
    /// MOT_IDLE says so.
    fn tick(&mut self, bit: u8, output: &mut Output, _: u16, parameters: &Parameters) -> bool {
        let is_idle = self.idle & bit != 0;
        self.idle &= !bit;
        if is_idle && parameters.is_on(Parameter::MotIdle) {
            if output.pulse() == 0 {
                output.set_pulse(output.travel().low());
            }
            return true;
        }
        false
    }

    fn timeout_ms(&self, _n: usize, parameters: &Parameters) -> u16 {
        parameters.get(Parameter::MotTimeout)
    }

    /// True, once, if the last esc.RawCommand of the commander had no command for this motor.
    fn is_left_out(&mut self, bit: u8, commander: u8) -> bool {
        let is_left_out = self.left_out & bit != 0 && self.left_out_by == commander;
        self.left_out &= !bit;
        is_left_out
    }

    /// Stops. A motor that was never commanded has no pulse.
    fn fail_safe(&mut self, _n: usize, output: &mut Output, _parameters: &Parameters) {
        if output.pulse() != 0 {
            output.set_pulse(output.travel().low());
        }
    }

    fn second(&mut self, _parameters: &Parameters) {
        self.refused_s = match self.refused_s.checked_sub(IN_THIS_SECOND) {
            None => 0,
            Some(seconds) => REFUSED_S.min(seconds + 1),
        };
    }

    /// Stops, whatever SAFE_MODE says.
    fn begin_safe(&mut self, output: &mut Output, _ends_pulses: bool) {
        if output.pulse() != 0 {
            output.set_pulse(output.travel().low());
        }
    }
}
