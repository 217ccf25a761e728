//! Outputs that are servos: they follow ArrayCommand over their travel.

use super::super::kind::Kind;
use super::super::output::Output;
use crate::tables::parameters::{OutputParameter, Parameters};

/// OUTn_FS: what the output does when commands stop. 3 ends the pulses.
mod failsafe {
    /// Holds the pulse.
    pub const HOLD: u8 = 0;
    /// Goes to OUTn_TRIM.
    pub const TRIM: u8 = 1;
    /// Goes to OUTn_FS_PWM.
    pub const PWM: u8 = 2;
}

/// The outputs of no other kind. All that they need is in [`Output`].
pub struct Servos;

impl Kind for Servos {
    /// None that is asked for.
    fn outputs(&self) -> u8 {
        0
    }

    fn update(&mut self, _n: usize, _bit: u8, _is_of_kind: bool, _parameters: &Parameters) {}

    fn is_actuator(&self) -> bool {
        true
    }

    /// Does what OUTn_FS says.
    #[inline(always)]
    fn fail_safe(&mut self, n: usize, output: &mut Output, parameters: &Parameters) {
        output.set_pulse(match parameters.of(n, OutputParameter::Fs) as u8 {
            failsafe::HOLD => return,
            failsafe::TRIM => output.travel().trim(),
            failsafe::PWM => output.travel().limit(parameters.of(n, OutputParameter::FsPwm) << 1),
            _ => 0,
        });
    }

    /// Ends the pulses if SAFE_MODE says so.
    #[inline(always)]
    fn begin_safe(&mut self, output: &mut Output, ends_pulses: bool) {
        if ends_pulses {
            output.set_pulse(0);
        }
    }
}
