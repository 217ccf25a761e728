//! No update over the bus: the bootloaders of the Arduinos listen to the serial port only.

use crate::eeprom::Eeprom;
use crate::handover::REQUEST_LEN;
use crate::tables::information;
use crate::tables::parameters::Parameters;
use crate::tables::wire::Transfer;

/// False.
pub const IS_THERE: bool = false;

/// False.
pub const HAS_TEXTS: bool = false;

/// The decision on a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Verdict {
    /// The program has no updates over the bus.
    NoLoader,
}

impl Verdict {
    /// No verdict has it.
    pub const IN_USE: u8 = 1;

    /// False.
    pub fn is_accepted(_number: u8) -> bool {
        false
    }

    /// The place and the length of the only text in the [`information`] in flash.
    pub fn text(_number: u8) -> (u8, u8) {
        const { information::text(0) }
    }
}

absent! {
    Update;
    fn start(&mut self, _has_loader: bool);
    // 0: the version in flash has it.
    fn mark(&self) -> u8 = 0;
    fn parameters_are_saved(&mut self);
    fn step(&mut self, _node: u8, _: &Parameters, _: &mut impl Eeprom);
    // Rejects the request.
    fn act_on_request(&mut self, _: &Transfer, _is_in_use: bool) -> Verdict = Verdict::NoLoader;
    fn is_accepted(&self) -> bool = false;
    fn answer(&mut self);
    fn is_answered(&self) -> bool = false;
    fn call_off(&mut self);
    fn hand_over(&mut self, _node: u8, _: &Parameters, _: &mut impl Eeprom)
        -> Option<&[u8; REQUEST_LEN]> = None;
}
