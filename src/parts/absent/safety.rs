//! No safety switch: it is always off.

use crate::tables::parameters::Parameters;

absent! {
    Safety;
    fn is_safe(&self) -> bool = false;
    fn is_safe_by(&self, _source: u8) -> bool = false;
    fn begin(&mut self, _source: u8);
    fn ends_pulses(&self, _parameters: &Parameters) -> bool = false;
    fn end(&mut self);
    fn second(&mut self) -> bool = false;
}
