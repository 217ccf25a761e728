//! The pace of a radio on the way to a station.
//!
//! A radio takes bytes from its serial port faster than it can send them, keeps what waits in a
//! buffer, and drops what does not fit. RADIO_STATUS says, about once a second, which part of the
//! buffer is free (`txbuf`, in per cent). The pace follows it: from two reports and the bytes
//! between them it estimates what the radio sends, and keeps most of the buffer free.
//!
//! Invariant: between two reports the pace lets no more bytes through than the estimated rate
//! carries, and none at all into a full buffer. So what does not fit waits in the queue, which
//! knows what is important, and not in the radio.

use super::budget::Budget;
use std::time::Duration;

/// Assumed size of the buffer, in bytes: that of the smallest radios (ExpressLRS has 1024). With a
/// larger one the estimate is a little high while the buffer fills, and right when it is steady.
const BUFFER: f64 = 1024.0;
/// Part of the buffer that the pace keeps free.
const KEEP_FREE: f64 = 0.75;
/// With this part free the radio sends all that it gets, and could send more.
const NEARLY_EMPTY: f64 = 0.95;
/// With less than this part free nothing is sent until the next report.
const FULL: f64 = 0.15;
/// Growth of the rate from report to report while the radio sends all that it gets. The excess of
/// one second must fit into the buffer.
const GROWTH: f64 = 1.2;
/// Rate before the first report, in bytes a second.
const FIRST_RATE: f64 = 1000.0;
/// Lowest rate: a stranger can send a RADIO_STATUS, too, but cannot silence the bridge with it.
const RATE_MIN: f64 = 100.0;
/// More than any serial port carries.
const RATE_MAX: f64 = 100_000.0;
/// A serial port without a report for this long has no radio.
const ABSENT_AFTER: Duration = Duration::from_secs(5);
/// A radio without a report for this long has left.
const GONE_AFTER: Duration = Duration::from_secs(30);
/// Longest wait for a report while the buffer is full.
const WAITS_MAX: Duration = Duration::from_secs(2);
/// Reports within this time are one: the second says nothing about the rate.
const REPORTS_APART: Duration = Duration::from_millis(80);

/// The pace of one radio.
pub struct Radio {
    budget: Budget,
    rate: f64,
    /// Time and free part of the last report; `None` before the first.
    report: Option<(Duration, f64)>,
    /// Bytes since the last report.
    sent: f64,
    /// Nothing is sent before this time.
    resumes_at: Duration,
    began_at: Duration,
}

impl Radio {
    /// A pace for a channel that may lead to a radio: slow until a report comes, or none has come.
    pub fn presumed(now: Duration) -> Radio {
        Radio {
            budget: Budget::starting(FIRST_RATE, now),
            rate: FIRST_RATE,
            report: None,
            sent: 0.0,
            resumes_at: now,
            began_at: now,
        }
    }

    /// True if there is no radio any more.
    pub fn is_gone(&self, now: Duration) -> bool {
        match self.report {
            Some((at, _)) => now > at + GONE_AFTER,
            None => now > self.began_at + ABSENT_AFTER,
        }
    }

    /// Adapts the rate to a report: `free_percent` of the buffer is free.
    pub fn report(&mut self, now: Duration, free_percent: u8) {
        let free = f64::from(free_percent.min(100)) / 100.0;
        if let Some((at, before)) = self.report {
            let passed = now.saturating_sub(at);
            if passed < REPORTS_APART {
                return;
            }
            let passed = passed.as_secs_f64();
            let drained = (self.sent - (before - free) * BUFFER).max(0.0) / passed;
            self.rate = if free < NEARLY_EMPTY {
                // Corrects the difference to the wanted part within a second.
                drained.min(self.rate) + (free - KEEP_FREE) * BUFFER
            } else if self.sent / passed > self.rate * 0.7 {
                self.rate * GROWTH
            } else {
                self.rate
            };
        } else if free < KEEP_FREE {
            self.rate += (free - KEEP_FREE) * BUFFER;
        }
        self.rate = self.rate.clamp(RATE_MIN, RATE_MAX);
        self.budget.set_rate(now, self.rate);
        self.resumes_at = if free < FULL { now + WAITS_MAX } else { now };
        self.report = Some((now, free));
        self.sent = 0.0;
    }

    /// True if a message may be sent now.
    pub fn has_room(&mut self, now: Duration) -> bool {
        self.budget.refill(now);
        now >= self.resumes_at && self.budget.tokens >= 1.0
    }

    /// Notes that bytes were sent.
    pub fn spend(&mut self, bytes: usize) {
        self.budget.tokens -= bytes as f64;
        self.sent += bytes as f64;
    }

    /// When something may be sent again.
    pub fn next(&self) -> Duration {
        self.budget.next().max(self.resumes_at)
    }

    /// For the user: the rate, if a radio has reported.
    pub fn text(&self) -> Option<String> {
        let (_, free) = self.report?;
        Some(format!("radio {:.0} B/s, {:.0} % free", self.rate, free * 100.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A radio with a buffer of `size` bytes that sends `air` bytes a second.
    struct Model {
        size: f64,
        air: f64,
        waiting: f64,
        lost: f64,
        sent: f64,
    }

    impl Model {
        fn new(size: f64, air: f64) -> Model {
            Model { size, air, waiting: 0.0, lost: 0.0, sent: 0.0 }
        }

        fn take(&mut self, bytes: f64) {
            self.waiting += bytes;
            self.lost += (self.waiting - self.size).max(0.0);
            self.waiting = self.waiting.min(self.size);
        }

        fn pass_ms(&mut self) {
            let sent = (self.air / 1000.0).min(self.waiting);
            self.waiting -= sent;
            self.sent += sent;
        }

        fn free_percent(&self) -> u8 {
            (100.0 * (self.size - self.waiting) / self.size) as u8
        }
    }

    /// Messages of 37 bytes, as many as the pace lets through, for `seconds`. Before, `quiet`
    /// seconds with 60 bytes a second. The radio reports each `period_ms`.
    fn run(mut model: Model, period_ms: u64, quiet: u64, seconds: u64) -> Model {
        let mut radio = Radio::presumed(Duration::ZERO);
        for ms in 0..(quiet + seconds) * 1000 {
            let now = Duration::from_millis(ms);
            model.pass_ms();
            if ms % period_ms == period_ms - 1 {
                radio.report(now, model.free_percent());
            }
            let is_quiet = ms < quiet * 1000;
            while (!is_quiet || ms % 1000 == 0) && radio.has_room(now) {
                let bytes = if is_quiet { 60 } else { 37 };
                radio.spend(bytes);
                model.take(bytes as f64);
                if is_quiet {
                    break;
                }
            }
            if ms + 1 == quiet * 1000 {
                (model.sent, model.lost) = (0.0, 0.0);
            }
        }
        model
    }

    #[test]
    fn no_radio_is_overrun_and_most_of_its_rate_is_used() {
        for size in [1024.0, 1850.0, 2048.0, 4096.0] {
            for air in [400.0, 800.0, 1600.0, 3200.0] {
                for period_ms in [100, 500, 1000] {
                    for quiet in [0, 3, 20] {
                        let model = run(Model::new(size, air), period_ms, quiet, 60);
                        let name = format!("{size} {air} {period_ms} {quiet}");
                        assert_eq!(model.lost, 0.0, "{name}: lost");
                        let used = model.sent / (air * 60.0);
                        assert!(used > 0.7, "{name}: {used}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_full_buffer_gets_nothing_until_the_next_report() {
        let mut radio = Radio::presumed(Duration::ZERO);
        let ms = Duration::from_millis;
        radio.report(ms(1000), 5);
        assert!(!radio.has_room(ms(2999)) && radio.has_room(ms(3000)));
        radio.report(ms(3100), 0);
        assert!(!radio.has_room(ms(3200)));
        radio.report(ms(3300), 60);
        assert!(radio.has_room(ms(4000)));
        assert_eq!(radio.next(), radio.budget.next().max(ms(3300)));
    }

    #[test]
    fn false_reports_slow_the_bridge_and_do_not_silence_it() {
        let mut radio = Radio::presumed(Duration::ZERO);
        let mut sent = 0;
        for ms in 0..60_000 {
            let now = Duration::from_millis(ms);
            if ms % 3000 == 0 {
                radio.report(now, 0);
            }
            while radio.has_room(now) {
                radio.spend(37);
                sent += 37;
            }
        }
        assert!(sent > 1500, "{sent}");
    }

    #[test]
    fn a_serial_port_without_reports_has_no_radio() {
        let s = Duration::from_secs;
        let mut radio = Radio::presumed(s(10));
        assert!(!radio.is_gone(s(15)) && radio.is_gone(s(16)));
        radio.report(s(14), 100);
        assert!(!radio.is_gone(s(44)) && radio.is_gone(s(45)));
    }
}
