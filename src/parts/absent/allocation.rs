//! Requests no node ID: a node without one stays without.

use crate::tables::wire::Transfer;

absent! {
    Allocation;
    fn start(&mut self, _unique_id: &[u8; 16], _now_ms: u16);
    fn is_due(&self, _now_ms: u16) -> bool = false;
    fn request(&mut self, _unique_id: &[u8; 16], _now_ms: u16, _put: impl FnMut(u8));
    fn act_on_message(&mut self, _: &Transfer, _unique_id: &[u8; 16], _now_ms: u16) -> u8 = 0;
}
