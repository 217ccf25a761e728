//! The parameters of the outputs 2 to 8, and how many outputs go with which rate.

use super::{Parameter, Parameters, Row};
use crate::hardware::SLOT_US;

/// The longest pulse of these outputs in microseconds. Between its end and the next output's pulse
/// there has to be a pause, which output 1 does not need: the timer ends its pulse.
const HIGHEST_PULSE: i32 = SLOT_US as i32 - 100;

macro_rules! rows {
    ($($output:literal)*) => {
        &[$(
            (concat!("OUT", $output, "_ID"), 0, 255, $output),
            (concat!("OUT", $output, "_MIN"), 500, HIGHEST_PULSE, 1000),
            (concat!("OUT", $output, "_TRIM"), 500, HIGHEST_PULSE, 1500),
            (concat!("OUT", $output, "_MAX"), 500, HIGHEST_PULSE, 2000),
            (concat!("OUT", $output, "_REVERSED"), 0, 1, 0),
            (concat!("OUT", $output, "_RANGE"), 10, 360, 90),
            (concat!("OUT", $output, "_TIMEOUT"), 0, 10_000, 1000),
            (concat!("OUT", $output, "_FS"), 0, 3, 0),
            (concat!("OUT", $output, "_FS_PWM"), 500, HIGHEST_PULSE, 1500),
            (concat!("OUT", $output, "_TYPE"), 0, 1, 0),
        )*]
    };
}

/// The rows of these outputs, in the order of [`OutputParameter`](super::OutputParameter).
pub const ROWS: &[Row] = rows!(2 3 4 5 6 7 8);

/// Parameters of an output.
pub const PARAMETERS: usize = 10;
const _: () = assert!(ROWS.len() == PARAMETERS * (crate::hardware::OUTPUTS - 1));

/// True if the pulses of so many outputs fit in a period of this rate one after the other.
fn is_room(count: u16, rate_hz: u16) -> bool {
    const SLOTS_PER_S: u32 = 1_000_000 / SLOT_US;
    // The pulse of a single output needs no slot.
    count == 1 || u32::from(count) * u32::from(rate_hz) <= SLOTS_PER_S
}

impl Parameters {
    /// True if a value in the range of the parameter with this index does not go with the values in
    /// force: so many pulses have no room in a period.
    pub(in crate::node) fn has_no_room(&self, index: u8, value: u16) -> bool {
        let (count, rate_hz) = (self.get(Parameter::OutCount), self.get(Parameter::OutRate));
        if index == Parameter::OutCount as u8 {
            !is_room(value, rate_hz)
        } else {
            index == Parameter::OutRate as u8 && !is_room(count, value)
        }
    }

    /// The number of outputs in use. If the EEPROM had values that do not go together, as many as
    /// have room.
    pub fn outputs(&self) -> usize {
        let mut count = self.get(Parameter::OutCount);
        while !is_room(count, self.get(Parameter::OutRate)) {
            count -= 1;
        }
        count.into()
    }
}
