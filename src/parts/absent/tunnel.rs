//! No tunnel: the serial monitor is for the serial port alone.

/// Length of a Targetted without characters.
pub const HEADER_LEN: u8 = 6;

absent! {
    Tunnel;
    fn act_on_message(&mut self, _: [u8; 3], _node: u8, _source: u8, _now_ms: u16) -> bool = false;
    fn has_room(&self) -> bool = true;
    fn push(&mut self, _character: u8);
    fn tick(&mut self, _now_ms: u16) -> bool = false;
    fn take(&mut self, _now_ms: u16, _put: impl FnMut(u8));
}
