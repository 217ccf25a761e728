//! Outputs that are relays: a pin that follows hardpoint.Command. hardpoint.Status says if it
//! holds.

use super::super::kind::Kind;
use super::super::output::Output;
use super::super::pulses::Pulses;
use super::levels::Levels;
use crate::hardware::OUTPUTS;
use crate::tables::parameters::{OutputParameter, Parameter, Parameters};

/// Which outputs are relays, and if they hold. In each set, bit n is output n.
pub struct Relays {
    relays: u8,
    held: u8,
    /// Relays whose pin is low while they hold.
    reversed: u8,
    /// For each output: beginnings of a second until the relay goes to the state of RELAY_START; 0
    /// for never. One more than RELAY_TIMEOUT, because the first may come at once.
    left_s: [u16; OUTPUTS],
    levels: Levels,
    /// Relays whose hardpoint.Status was sent in this round.
    reported: u8,
}

impl Relays {
    /// No output is a relay.
    pub const fn new() -> Self {
        Self {
            relays: 0,
            held: 0,
            reversed: 0,
            left_s: [0; OUTPUTS],
            levels: Levels::new(),
            reported: 0,
        }
    }

    /// Has these relays hold or release, and begins their time of RELAY_TIMEOUT.
    pub fn act_on_command(&mut self, relays: u8, holds: bool, parameters: &Parameters) {
        self.held &= !relays;
        if holds {
            self.held |= relays;
        }
        let timeout_s = parameters.get(Parameter::RelayTimeout);
        let mut bits = relays;
        for left_s in &mut self.left_s {
            if bits & 1 != 0 {
                *left_s = if timeout_s == 0 { 0 } else { timeout_s + 1 };
            }
            bits >>= 1;
        }
    }

    /// The bit of the relay for the next hardpoint.Status, and true if it holds: they take turns.
    /// 0 if there is no relay.
    pub fn next_to_report(&mut self) -> (u8, bool) {
        let mut left = self.relays & !self.reported;
        if left == 0 {
            self.reported = 0;
            left = self.relays;
        }
        let bit = left & left.wrapping_neg();
        self.reported |= bit;
        (bit, self.held & bit != 0)
    }
}

impl Kind for Relays {
    #[inline(always)]
    fn outputs(&self) -> u8 {
        self.relays
    }

    /// Applies OUTn_REVERSED. An output that becomes a relay begins with the state of RELAY_START.
    fn update(&mut self, n: usize, bit: u8, is_of_kind: bool, parameters: &Parameters) {
        let was_relay = self.relays & bit != 0;
        self.relays &= !bit;
        if !is_of_kind {
            return;
        }
        self.relays |= bit;
        self.reversed &= !bit;
        if parameters.of(n, OutputParameter::Reversed) as u8 != 0 {
            self.reversed |= bit;
        }
        if !was_relay {
            self.held = self.held & !bit | parameters.get(Parameter::RelayStart) as u8 & bit;
        }
    }

    /// A relay follows no entry, and has a time of its own.
    fn fail_safe(&mut self, _n: usize, _output: &mut Output, _parameters: &Parameters) {}

    /// A relay keeps its state.
    fn begin_safe(&mut self, _output: &mut Output, _ends_pulses: bool) {}

    /// Without a command for RELAY_TIMEOUT a relay goes to its state of RELAY_START.
    fn second(&mut self, parameters: &Parameters) {
        let mut bit = 1;
        for left_s in &mut self.left_s {
            if *left_s != 0 {
                *left_s -= 1;
                if *left_s == 0 {
                    let start = parameters.get(Parameter::RelayStart) as u8;
                    self.held = self.held & !bit | start & bit;
                }
            }
            bit <<= 1;
        }
    }

    fn show(&mut self, board: &mut impl Pulses) {
        self.levels.drive(self.relays, self.held ^ self.reversed, board);
    }
}
