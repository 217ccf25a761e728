//! What a kind of output answers.

use super::output::Output;
use super::pulses::Pulses;
use super::travel::{CommandType, Ticks, Travel};
use crate::tables::parameters::{OutputParameter, Parameters};

/// A kind of output: what all outputs with the same OUTn_TYPE do, and the state that only these
/// have. An answer that most kinds give is that of the trait.
///
/// An output is named by its number `n`, or by its `bit` in a set: bit n is output n. Some
/// questions are asked of each kind, and then the output need not be of this kind.
#[allow(dead_code, reason = "a build may have servos only")]
pub trait Kind {
    /// The outputs of this kind, a bit each.
    fn outputs(&self) -> u8;

    /// Applies the parameters of an output, which `is_of_kind` or not. Asked of each kind.
    fn update(&mut self, n: usize, bit: u8, is_of_kind: bool, parameters: &Parameters);

    /// True if OUTn_ID is an actuator ID: the outputs follow ArrayCommand, and send
    /// actuator.Status.
    fn is_actuator(&self) -> bool {
        false
    }

    /// True if the outputs follow a node only while its ArmingStatus says that the vehicle is
    /// armed. Others do so if ARM_REQ says it.
    fn needs_armed(&self) -> bool {
        false
    }

    /// Puts the command that waits into the output's entry, if this kind keeps it elsewhere. Asked
    /// of each kind.
    fn unpack(&mut self, _bit: u8, _output: &mut Output) {}

    /// The pulse that a command means; 0 for none. `value` is [`CommandType::fixed`].
    fn pulse(&mut self, _bit: u8, travel: &Travel, unit: CommandType, value: i16) -> Ticks {
        travel.pulse(unit, value)
    }

    /// Does what is due without a followed command. Returns true if the pulse may have changed.
    /// Asked of each kind.
    fn tick(
        &mut self,
        _bit: u8,
        _output: &mut Output,
        _now_ms: u16,
        _parameters: &Parameters,
    ) -> bool {
        false
    }

    /// Time without a command until the failsafe, in milliseconds; 0 for never.
    fn timeout_ms(&self, n: usize, parameters: &Parameters) -> u16 {
        parameters.of(n, OutputParameter::Timeout)
    }

    /// True, once, if the node that the output follows has stopped to command it. Asked of each
    /// kind.
    fn is_left_out(&mut self, _bit: u8, _commander: u8) -> bool {
        false
    }

    /// The failsafe of an output that follows commands: what it does until the next command.
    fn fail_safe(&mut self, n: usize, output: &mut Output, parameters: &Parameters);

    /// The safety switch is on. `ends_pulses` is SAFE_MODE.
    fn begin_safe(&mut self, output: &mut Output, ends_pulses: bool);

    /// Does the work of each second.
    fn second(&mut self, _parameters: &Parameters) {}

    /// Sets the levels of pins without pulses.
    fn show(&mut self, _board: &mut impl Pulses) {}
}
