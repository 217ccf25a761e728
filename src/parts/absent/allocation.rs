//! Requests no node ID: a node without one stays without.

use crate::tables::wire::Transfer;

/// Nothing.
#[derive(Default)]
pub struct Allocation;

impl Allocation {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// Does nothing.
    pub fn start(&mut self, _unique_id: &[u8; 16], _now_ms: u16) {}

    /// False.
    pub fn is_due(&self, _now_ms: u16) -> bool {
        false
    }

    /// Does nothing.
    pub fn request(&mut self, _unique_id: &[u8; 16], _now_ms: u16, _put: impl FnMut(u8)) {}

    /// 0.
    pub fn act_on_message(&mut self, _: &Transfer, _unique_id: &[u8; 16], _now_ms: u16) -> u8 {
        0
    }
}
