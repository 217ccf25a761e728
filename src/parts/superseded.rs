//! Counts the commands that a newer one replaced before an output followed them. On a full bus they
//! are many: the outputs follow the newest.

use crate::monitor::{Line, Monitor};

/// The number of such commands.
#[derive(Default)]
pub struct Superseded {
    /// Since the start, modulo 65,536.
    total: u16,
    /// The monitor has said that there are some.
    is_told: bool,
}

impl Superseded {
    /// None yet.
    pub const fn new() -> Self {
        Self { total: 0, is_told: false }
    }

    /// Counts a command, of which an entry replaced one that waited.
    pub fn count(&mut self) {
        self.total = self.total.wrapping_add(1);
    }

    /// Logs the number, once after the first. Call once a second.
    pub fn second(&mut self, monitor: &mut Monitor) {
        if self.total != 0 && !self.is_told {
            self.is_told = true;
            self.report(monitor);
        }
    }

    /// Logs the number.
    #[inline(never)]
    pub fn report(&self, monitor: &mut Monitor) {
        monitor.log_line(Line::Superseded).set_a(self.total);
    }
}
