//! No battery is watched.

use crate::parts::power::Power;
use crate::tables::parameters::Parameters;

/// Nothing.
#[derive(Default)]
pub struct Battery;

impl Battery {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// Does nothing.
    pub fn add(&mut self, _centiamperes: i16, _now_ms: u16) {}

    /// Does nothing.
    pub fn put(&self, _: &Power, _: Option<(u16, u8)>, _: &Parameters, _put: impl FnMut(u16)) {}
}
