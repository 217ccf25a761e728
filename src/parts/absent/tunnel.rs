//! No tunnel: the serial monitor is for the serial port alone.

/// Length of a Targetted without characters.
pub const HEADER_LEN: u8 = 6;

/// Nothing.
#[derive(Default)]
pub struct Tunnel;

impl Tunnel {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// False.
    pub fn act_on_message(&mut self, _: [u8; 3], _node: u8, _source: u8, _now_ms: u16) -> bool {
        false
    }

    /// True.
    pub fn has_room(&self) -> bool {
        true
    }

    /// Does nothing.
    pub fn push(&mut self, _character: u8) {}

    /// False.
    pub fn tick(&mut self, _now_ms: u16) -> bool {
        false
    }

    /// Does nothing.
    pub fn take(&mut self, _now_ms: u16, _put: impl FnMut(u8)) {}
}
