//! No debug.LogMessage.

use crate::monitor::Change;
use crate::tables::condition::Conditions;

absent! {
    Log;
    fn begin(&mut self, _now: Conditions, _now_ms: u16) -> Option<Change> = None;
    fn push(&mut self, _character: u8) -> bool = false;
    fn is_due(&self) -> bool = false;
    fn take(&mut self, _now: Conditions, _now_ms: u16, _put: impl FnMut(u8)) -> bool = false;
    fn tell_again(&mut self, _conditions: Conditions);
}
