//! The delay of a node's answers, and the timeout for the next one: the estimator of TCP (RFC
//! 6298).

use std::time::Duration;

/// Longest timeout.
const TIMEOUT_MAX: Duration = Duration::from_secs(2);
/// Each timeout in a row doubles the next, at most this many times.
const DOUBLED_MAX: u32 = 3;

/// Smoothed delay of answers, and its variation.
#[derive(Clone, Copy, Debug, Default)]
pub struct Delay {
    /// `None` before the first answer.
    smoothed: Option<Duration>,
    variation: Duration,
    /// Timeouts since the last answer.
    timed_out: u32,
}

impl Delay {
    /// True after the first answer.
    pub fn is_known(&self) -> bool {
        self.smoothed.is_some()
    }

    /// Adds the delay of an answer.
    pub fn measured(&mut self, delay: Duration) {
        self.timed_out = 0;
        match self.smoothed {
            None => {
                self.smoothed = Some(delay);
                self.variation = delay / 2;
            }
            Some(smoothed) => {
                self.variation = (self.variation * 3 + smoothed.abs_diff(delay)) / 4;
                self.smoothed = Some((smoothed * 7 + delay) / 8);
            }
        }
    }

    /// Notes that no answer arrived in time.
    pub fn timed_out(&mut self) {
        self.timed_out = (self.timed_out + 1).min(DOUBLED_MAX);
    }

    /// Timeout for the next answer, at least `least`. Before the first answer it follows from
    /// `others`.
    pub fn timeout(&self, least: Duration, others: &Delay) -> Duration {
        let known = if self.is_known() { self } else { others };
        let usual =
            known.smoothed.map_or(Duration::ZERO, |smoothed| smoothed + known.variation * 4);
        (usual.max(least) * (1 << self.timed_out)).clamp(least, TIMEOUT_MAX.max(least))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAST: Duration = Duration::from_millis(300);

    #[test]
    fn a_slow_node_gets_a_longer_timeout() {
        let mut delay = Delay::default();
        assert_eq!(delay.timeout(LEAST, &Delay::default()), LEAST);
        (0..20).for_each(|_| delay.measured(Duration::from_millis(800)));
        let timeout = delay.timeout(LEAST, &Delay::default());
        assert!((800..900).contains(&timeout.as_millis()), "{timeout:?}");
        (0..40).for_each(|_| delay.measured(Duration::from_millis(10)));
        assert_eq!(delay.timeout(LEAST, &Delay::default()), LEAST);
    }

    #[test]
    fn repeated_timeouts_double_the_timeout_up_to_two_seconds() {
        let mut delay = Delay::default();
        let timeouts: Vec<u128> = (0..5)
            .map(|_| {
                let timeout = delay.timeout(LEAST, &Delay::default()).as_millis();
                delay.timed_out();
                timeout
            })
            .collect();
        assert_eq!(timeouts, [300, 600, 1200, 2000, 2000]);
    }
}
