//! Outputs that are motors: they follow esc.RawCommand in place of ArrayCommand.

use dronecan_wire::esc;

use crate::tables::parameters::{OutputParameter, Parameters};
use crate::tables::wire::{KEPT, Transfer};

/// True if an output can be a motor.
pub const ARE_THERE: bool = true;

/// OUTn_TYPE: the output is a motor. 0 is a servo.
const MOTOR: u8 = 1;

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

/// A command for a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Throttle {
    /// Node ID of the sender.
    pub source: u8,
    /// Transfer ID of the command.
    pub transfer: u8,
    /// -8192 to 8191.
    pub value: i16,
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
            left_out: 0,
            left_out_by: 0,
            len: 0,
            commanded: 0,
        }
    }

    /// Applies OUTn_TYPE of an output. Returns true if it is a motor.
    pub fn update(&mut self, output: usize, parameters: &Parameters) -> bool {
        let is_motor = parameters.of(output, OutputParameter::Type) as u8 == MOTOR;
        let bit = 1 << output;
        self.motors = if is_motor { self.motors | bit } else { self.motors & !bit };
        // A command for the old type or ID gives no pulse.
        self.idle &= !bit;
        (self.len, self.commanded) = (0, 0);
        is_motor
    }

    /// True if the output is a motor.
    #[inline(always)]
    pub fn is_motor(&self, output: usize) -> bool {
        self.motors & 1 << output != 0
    }

    /// True if an output in use is a motor.
    #[inline(always)]
    pub fn is_any(&self) -> bool {
        self.motors != 0
    }

    /// The motors for which an esc.RawCommand of `len` bytes has a command: bit n is output n.
    /// `indices` has the ID of each output.
    #[inline(always)]
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
    #[inline(always)]
    pub fn leave_out(&mut self, source: u8, found: u8) {
        self.left_out = self.motors & !found;
        self.left_out_by = source;
    }

    /// True, once, if the last esc.RawCommand left out the motor with this bit, which follows the
    /// commands of the node `commander`: it stops.
    #[inline(always)]
    pub fn takes_left_out(&mut self, bit: u8, commander: u8) -> bool {
        let is_left_out = self.left_out & bit != 0 && self.left_out_by == commander;
        self.left_out &= !bit;
        is_left_out
    }

    /// These motors, a bit each, got a command that they must not follow.
    #[inline(always)]
    pub fn refuse(&mut self, motors: u8) {
        self.idle |= motors;
    }

    /// True, once, if the motor with this bit got a command that it must not follow.
    #[inline(always)]
    pub fn takes_idle(&mut self, bit: u8) -> bool {
        let is_idle = self.idle & bit != 0;
        self.idle &= !bit;
        is_idle
    }

    /// Takes the command that is kept for the motor with this bit, whose ID is `index`.
    #[inline(always)]
    pub fn take(&mut self, bit: u8, index: u8) -> Option<Throttle> {
        if self.kept & bit == 0 {
            return None;
        }
        self.kept &= !bit;
        self.unpack(index)
    }

    /// The command that is kept for a motor with this ID.
    #[inline(always)]
    pub fn unpack(&self, index: u8) -> Option<Throttle> {
        let value = esc::raw_command(&self.payload, index)?;
        Some(Throttle { source: self.source, transfer: self.transfer, value })
    }
}

impl Default for Motors {
    fn default() -> Self {
        Self::new()
    }
}
