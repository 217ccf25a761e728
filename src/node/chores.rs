//! Work that takes long and therefore gets a turn of its own.

/// A kind of such work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Chore {
    /// Apply parameters that were set.
    ApplyParameters = 1 << 0,
    /// Compute a temperature: the sum of readings is complete.
    Measure = 1 << 1,
    /// Do the work of each second.
    Second = 1 << 2,
    /// Compute voltage and current: their sums of readings are complete.
    MeasurePower = 1 << 3,
}

/// A set of chores.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chores(u8);

impl Chores {
    /// No chore.
    pub const NONE: Self = Self(0);

    /// True if no chore is pending.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Adds a chore.
    pub fn add(&mut self, chore: Chore) {
        self.0 |= chore as u8;
    }

    /// Removes a chore. Returns true if it was in the set.
    pub fn remove(&mut self, chore: Chore) -> bool {
        let is_pending = self.0 & chore as u8 != 0;
        self.0 &= !(chore as u8);
        is_pending
    }
}
