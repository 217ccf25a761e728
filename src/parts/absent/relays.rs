//! No output is a relay.

use crate::parts::outputs::Pulses;
use crate::tables::parameters::Parameters;

/// The greatest OUTn_TYPE.
#[allow(dead_code, reason = "a build may have no OUTn_TYPE")]
pub const GREATEST_TYPE: i32 = 1;

/// Nothing.
#[derive(Default)]
pub struct Relays;

impl Relays {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// False: the output is no relay.
    pub fn update(&mut self, _output: usize, _bit: u8, _parameters: &Parameters) -> bool {
        false
    }

    /// None.
    pub fn all(&self) -> u8 {
        0
    }

    /// Does nothing.
    pub fn act_on_command(&mut self, _relays: u8, _holds: bool, _parameters: &Parameters) {}

    /// Does nothing.
    pub fn second(&mut self, _parameters: &Parameters) {}

    /// Does nothing.
    pub fn show(&mut self, _board: &mut impl Pulses) {}

    /// None.
    pub fn next_to_report(&mut self) -> (u8, bool) {
        (0, false)
    }
}
