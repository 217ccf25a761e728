//! What a reader of the log knows of the conditions.

use crate::tables::condition::Conditions;

/// The begin or the end of a condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// The number of the condition.
    pub number: u8,
    /// True if it begins.
    pub begins: bool,
}

/// The conditions that a reader was told of as set. Others are not set, as far as the reader knows.
#[derive(Default)]
pub struct Told(Conditions);

impl Told {
    /// Nothing was told yet.
    pub const fn new() -> Self {
        Self(Conditions::NONE)
    }

    /// The conditions that are not as the reader knows them, also those that no line tells.
    pub fn changed(&self, now: Conditions) -> Conditions {
        self.0.xor(now)
    }

    /// The reader is told of the next change, but not of conditions that are `told` already, to
    /// which it is added. `None` if there is none.
    #[inline(always)]
    pub fn next(&mut self, now: Conditions, told: &mut Conditions) -> Option<Change> {
        let changed = self.changed(now.told()).without(*told);
        if changed.is_empty() {
            return None;
        }
        let (number, condition) = changed.first();
        *told = told.or(condition);
        self.0 = self.0.xor(condition);
        Some(Change { number, begins: self.0.has(condition) })
    }

    /// The reader is told of a condition as it is.
    pub fn tell(&mut self, condition: Conditions, begins: bool) {
        self.0.set(condition, begins);
    }

    /// The reader is to be told again that a condition is set.
    #[inline(never)]
    pub fn forget(&mut self, condition: Conditions) {
        self.0.set(condition, false);
    }
}
