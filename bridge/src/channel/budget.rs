//! How much may be sent through a channel whose rate is known.

use std::time::Duration;

/// Longer than any message, for a rate at which that takes its time.
const BURST_MIN: f64 = 300.0;
/// A leaky bucket.
pub struct Budget {
    /// Bytes a second.
    rate: f64,
    burst: f64,
    /// Bytes that may be sent now. Below zero after a message that was longer.
    pub tokens: f64,
    at: Duration,
}

impl Budget {
    pub fn new(rate: f64) -> Budget {
        let burst = (rate / 20.0).max(BURST_MIN);
        Budget { rate, burst, tokens: burst, at: Duration::ZERO }
    }

    pub fn refill(&mut self, now: Duration) {
        self.tokens = (self.tokens + self.rate * now.saturating_sub(self.at).as_secs_f64()).min(self.burst);
        self.at = now;
    }

    /// When there is something to spend again.
    pub fn next(&self) -> Duration {
        self.at + Duration::from_secs_f64((1.0 - self.tokens).max(0.0) / self.rate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_is_kept_over_time() {
        let mut budget = Budget::new(5760.0);
        let mut spent = 0.0;
        for ms in 0..10_000 {
            budget.refill(Duration::from_millis(ms));
            while budget.tokens >= 1.0 {
                budget.tokens -= 29.0;
                spent += 29.0;
            }
        }
        assert!((57_000.0..58_500.0).contains(&spent), "{spent}");
    }
}
