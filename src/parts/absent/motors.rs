//! No output is a motor.

use crate::tables::parameters::Parameters;
use crate::tables::wire::Transfer;

/// False: no output can be a motor.
pub const ARE_THERE: bool = false;

/// Nothing.
#[derive(Default)]
pub struct Motors;

impl Motors {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// False: the output is a servo.
    pub fn update(&mut self, _output: usize, _parameters: &Parameters) -> bool {
        false
    }

    /// False: the output is a servo.
    pub fn is_motor(&self, _output: usize) -> bool {
        false
    }

    /// False: all outputs are servos.
    pub fn is_any(&self) -> bool {
        false
    }

    /// None.
    pub fn commanded(&mut self, _commands: u8, _indices: impl Iterator<Item = u8>) -> u8 {
        0
    }

    /// None.
    pub fn kept(&self) -> u8 {
        0
    }

    /// Nothing.
    pub fn keep(&mut self, _command: &Transfer, _motors: u8) {}

    /// Nothing.
    pub fn leave_out(&mut self, _source: u8, _found: u8) {}

    /// False.
    pub fn takes_left_out(&mut self, _bit: u8, _commander: u8) -> bool {
        false
    }

    /// Nothing.
    pub fn refuse(&mut self, _motors: u8) {}

    /// False.
    pub fn takes_idle(&mut self, _bit: u8) -> bool {
        false
    }

    /// `None`: the output is a servo.
    pub fn unpack(&self, _index: u8) -> Option<Throttle> {
        None
    }

    /// `None`: the output is a servo.
    pub fn take(&mut self, _bit: u8, _index: u8) -> Option<Throttle> {
        None
    }
}

/// A command for a motor.
#[derive(Clone, Copy)]
pub struct Throttle {
    /// Node ID of the sender.
    pub source: u8,
    /// Transfer ID of the command.
    pub transfer: u8,
    /// -8192 to 8191.
    pub value: i16,
}
