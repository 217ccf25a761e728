//! Without CanStats and GetTransportStats: nothing is counted.

use crate::hardware::CanCounters;

/// Nothing.
#[derive(Default)]
pub struct Stats;

/// There is no response.
pub const LEN: usize = 0;

impl Stats {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// Does nothing.
    pub fn count_received(&mut self) {}

    /// Does nothing.
    pub fn count_sent(&mut self) {}

    /// Does nothing.
    pub fn count_broken(&mut self) {}

    /// Does nothing.
    pub fn put_transport(&self, _counters: &impl CanCounters, _put: impl FnMut(u16, u16)) {}

    /// Does nothing.
    pub fn put_can(&self, _counters: &impl CanCounters, _put: impl FnMut(u16)) {}
}
