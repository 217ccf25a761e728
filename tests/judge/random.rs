//! Random choices.

use bench::Noise;

/// The source of them.
pub struct Random(Noise);

impl Random {
    /// Each seed has its own choices.
    pub fn new(seed: u64) -> Self {
        Self(Noise::new(seed))
    }

    /// From 0 to `limit - 1`.
    pub fn below(&mut self, limit: u64) -> u64 {
        self.0.below(limit)
    }

    /// True in so many of a hundred cases.
    pub fn percent(&mut self, percent: u64) -> bool {
        self.below(100) < percent
    }

    /// One of these.
    pub fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len() as u64) as usize]
    }
}
