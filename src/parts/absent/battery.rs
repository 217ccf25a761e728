//! No battery is watched.

use crate::parts::power::Power;
use crate::tables::parameters::Parameters;

absent! {
    Battery;
    fn add(&mut self, _centiamperes: i16, _now_ms: u16);
    fn put(&self, _: &Power, _: Option<(u16, u8)>, _: &Parameters, _put: impl FnMut(u16));
}
