//! Limits what is sent through a channel to its rate.

use std::time::Duration;

/// Bytes that may be saved up, more than any message has. Otherwise a slow channel could never send
/// a long message.
const BURST_MIN: f64 = 300.0;
/// A token bucket.
pub struct Budget {
    /// Rate in bytes a second.
    rate: f64,
    burst: f64,
    /// Bytes that may be sent now. Negative after a message that was longer.
    pub tokens: f64,
    at: Duration,
}

impl Budget {
    pub fn new(rate: f64) -> Budget {
        let burst = (rate / 20.0).max(BURST_MIN);
        Budget { rate, burst, tokens: burst, at: Duration::ZERO }
    }

    /// A budget that begins at `now` with nothing saved up.
    pub fn starting(rate: f64, now: Duration) -> Budget {
        Budget { tokens: 0.0, at: now, ..Budget::new(rate) }
    }

    /// Changes the rate. What was saved up stays, as far as the new rate allows.
    pub fn set_rate(&mut self, now: Duration, rate: f64) {
        self.refill(now);
        let Budget { rate, burst, .. } = Budget::new(rate);
        (self.rate, self.burst, self.tokens) = (rate, burst, self.tokens.min(burst));
    }

    pub fn refill(&mut self, now: Duration) {
        self.tokens =
            (self.tokens + self.rate * now.saturating_sub(self.at).as_secs_f64()).min(self.burst);
        self.at = now;
    }

    /// When something may be sent again.
    pub fn next(&self) -> Duration {
        self.at + Duration::from_secs_f64((1.0 - self.tokens).max(0.0) / self.rate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_limits_the_rate() {
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
