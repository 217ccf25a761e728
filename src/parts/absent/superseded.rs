//! No count of superseded commands. With one output it would take 86 bytes of the ATmega168.

use crate::monitor::Monitor;

absent! {
    Superseded;
    fn count(&mut self);
    fn second(&mut self, _: &mut Monitor);
    fn report(&self, _: &mut Monitor);
}
