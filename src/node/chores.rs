//! Work that takes long and therefore gets a turn of its own.

/// A set of chores. Those with a name have one each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chores(u8);

impl Chores {
    /// No chore.
    pub const NONE: Self = Self(0);
    /// Apply parameters that were set.
    pub const APPLY_PARAMETERS: Self = Self(1 << 0);
    /// Compute a temperature: the sum of readings is complete.
    pub const MEASURE: Self = Self(1 << 1);
    /// Do the work of each second.
    pub const SECOND: Self = Self(1 << 2);
    /// Compute voltage and current: their sums of readings are complete.
    pub const MEASURE_POWER: Self = Self(1 << 3);

    /// True if no chore is pending.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Adds a chore.
    pub fn add(&mut self, chore: Self) {
        self.0 |= chore.0;
    }

    /// Removes the first chore in the order above and returns it; [`NONE`](Self::NONE) if there is
    /// none.
    pub fn take_first(&mut self) -> Self {
        let first = Self(self.0 & self.0.wrapping_neg());
        self.0 ^= first.0;
        first
    }
}
