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

    /// Takes the next change that the reader does not know, but none of the conditions in
    /// `told_now`, and adds its condition to them. `None` if there is no change.
    #[inline(always)]
    pub fn next(&mut self, now: Conditions, told_now: &mut Conditions) -> Option<Change> {
        let changed = self.changed(now.told()).without(*told_now);
        if changed.is_empty() {
            return None;
        }
        let (number, condition) = changed.first();
        *told_now = told_now.or(condition);
        self.0 = self.0.xor(condition);
        Some(Change { number, begins: self.0.has(condition) })
    }

    /// From now on the reader knows whether a condition is set.
    pub fn tell(&mut self, condition: Conditions, begins: bool) {
        self.0.set(condition, begins);
    }

    /// The reader forgets that a condition is set, so that it is told again.
    #[inline(never)]
    pub fn forget(&mut self, condition: Conditions) {
        self.0.set(condition, false);
    }
}
