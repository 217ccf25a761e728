//! Without CanStats and GetTransportStats: nothing is counted.

use crate::hardware::CanCounters;

/// There is no response.
pub const LEN: usize = 0;

absent! {
    Stats;
    fn count_received(&mut self);
    fn count_sent(&mut self);
    fn count_broken(&mut self);
    fn put_transport(&self, _counters: &impl CanCounters, _put: impl FnMut(u16, u16));
    fn put_can(&self, _counters: &impl CanCounters, _put: impl FnMut(u16));
}
