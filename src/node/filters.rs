//! The change of the controller's filters that is pending.

/// The longest time that new filters wait for the end of an outgoing transfer, in seconds. Longer
/// than a transfer may take.
const WAIT_S: u8 = 4;

/// A change of the filters.
pub struct Filters {
    /// Seconds until new filters are set even during a transfer. 0 if no new filters are pending.
    left_s: u8,
}

impl Filters {
    /// No change is pending.
    pub const fn new() -> Self {
        Self { left_s: 0 }
    }

    /// Wants new filters.
    pub fn change(&mut self) {
        self.left_s = WAIT_S;
    }

    /// The controller got its filters.
    pub fn are_set(&mut self) {
        self.left_s = 0;
    }

    /// True if new filters are pending.
    pub fn are_pending(&self) -> bool {
        self.left_s != 0
    }

    /// True if the pending filters wait no longer.
    pub fn are_urgent(&self) -> bool {
        self.left_s == 1
    }

    /// Counts a second.
    pub fn second(&mut self) {
        if self.left_s > 1 {
            self.left_s -= 1;
        }
    }
}
