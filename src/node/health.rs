//! The node's health: its conditions, its counters, and the level that WARN_MASK, ERROR_MASK and
//! CRIT_MASK give the conditions. Without the feature `masks` each condition has the level of its
//! row.

use crate::monitor::{Line, Monitor};
use crate::tables::condition::{
    CRIT_MASK, Conditions, ERROR_MASK, HOLD_S, Level, RESET_HOLD_S, ResetCause, WARN_MASK,
};
use crate::tables::parameters::{Parameter, Parameters};

/// Events since the start. All counters are modulo 65,536.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Commands that were followed.
    pub followed: u16,
    /// Frames and transfers that were rejected.
    pub refused: u16,
    /// Times that the controller reported lost frames.
    pub overruns: u16,
    /// Times that sending was given up, because frames waited for a second without success.
    pub given_up: u16,
}

/// Increments a counter, modulo 65,536, and returns it.
#[inline(never)]
pub fn count(counter: &mut u16) -> u16 {
    *counter = counter.wrapping_add(1);
    *counter
}

/// The node's conditions and counters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Health {
    /// The conditions that are set.
    pub conditions: Conditions,
    /// Beginnings of a second until the temporary conditions are cleared.
    hold_s: u8,
    /// Events since the start.
    pub counts: Counts,
}

impl Health {
    /// No condition set, all counters 0.
    pub const fn new() -> Self {
        Self {
            conditions: Conditions::NONE,
            hold_s: 0,
            counts: Counts { followed: 0, refused: 0, overruns: 0, given_up: 0 },
        }
    }

    /// Sets the condition for the reset cause, which [`second`](Self::second) clears after
    /// [`RESET_HOLD_S`].
    pub fn start(&mut self, cause: ResetCause) {
        if let Some(conditions) = Conditions::after(cause) {
            self.conditions = conditions;
            self.hold_s = RESET_HOLD_S;
        }
    }

    /// The vendor-specific status code.
    pub fn code(&self) -> u16 {
        self.conditions.code()
    }

    /// True if this condition, or one of these, is set.
    pub fn has(&self, condition: Conditions) -> bool {
        self.conditions.has(condition)
    }

    /// True if other nodes do not receive what the node sends, or did not a moment ago.
    pub fn is_or_was_cut_off(&self) -> bool {
        self.has(Conditions::CUT_OFF)
    }

    /// The worst level that the masks give to a condition of this status code, except those that
    /// are `excused`.
    pub fn level(code: u16, parameters: &Parameters, excused: Conditions) -> Level {
        let code = code & !excused.code();
        if code & parameters.get_or(Parameter::CritMask, CRIT_MASK) != 0 {
            Level::Critical
        } else if code & parameters.get_or(Parameter::ErrorMask, ERROR_MASK) != 0 {
            Level::Error
        } else if code & parameters.get_or(Parameter::WarnMask, WARN_MASK) != 0 {
            Level::Warning
        } else {
            Level::Ok
        }
    }

    /// Sets or clears a condition.
    #[inline(never)]
    pub fn set(&mut self, condition: Conditions, on: bool) {
        self.conditions.set(condition, on);
    }

    /// Sets a condition that is always told by the status code.
    pub fn set_silently(&mut self, condition: Conditions) {
        self.conditions.set(condition, true);
    }

    /// Clears a condition.
    pub fn clear(&mut self, condition: Conditions) {
        self.conditions.set(condition, false);
    }

    /// Sets a temporary condition. [`second`](Self::second) clears it [`HOLD_S`] after the last
    /// event, or with the cause of the reset if that is later. TRANSFER_ERRORS, which others
    /// cause, does not prolong the rest and is cleared with it.
    #[inline(never)]
    pub fn happened(&mut self, condition: Conditions) {
        self.set(condition, true);
        if condition != Conditions::TRANSFER_ERRORS || self.hold_s == 0 {
            // The first second may begin at once.
            self.hold_s = self.hold_s.max(HOLD_S + 1);
        }
    }

    /// Clears the temporary conditions when their time is over. Call once a second.
    pub fn second(&mut self) {
        if self.hold_s > 0 {
            self.hold_s -= 1;
            if self.hold_s == 0 {
                self.conditions.pass();
            }
        }
    }

    /// Logs the counters.
    #[inline(never)]
    pub fn report(&self, monitor: &mut Monitor) {
        let counts_in = monitor.log_line(Line::CountsIn);
        counts_in.set_a(self.counts.followed);
        counts_in.set_b(self.counts.refused);
        let counts_out = monitor.log_line(Line::CountsOut);
        counts_out.set_a(self.counts.overruns);
        counts_out.set_b(self.counts.given_up);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::golden;

    #[test]
    fn by_default_a_fault_is_a_warning_failsafe_an_error_and_lost_parameters_critical() {
        // In the order of the bits: transfers that broke, being disarmed and the draft are no fault
        // of the node.
        let expected = [1, 0, 1, 1, 1, 1, 1, 1, 2, 1, 1, 3, 0, 0];
        for (condition, level) in golden::CONDITIONS.into_iter().zip(expected) {
            assert_eq!(
                Health::level(condition.code(), &golden::parameters(&[]), Conditions::NONE) as u8,
                level,
                "{:#06x}",
                condition.code()
            );
        }
    }

    #[test]
    fn temporary_conditions_stay_set_for_ten_whole_seconds_and_others_until_cleared() {
        let mut health = Health::new();
        health.set(Conditions::FAILSAFE, true);
        for again in [3, 9, 0] {
            health.happened(Conditions::BUS_OFF);
            for _ in 0..again {
                health.second();
            }
        }
        health.happened(Conditions::FRAMES_LOST);
        for second in 0..11 {
            assert_eq!(health.code(), 1 << 5 | 1 << 7 | 1 << 10, "{second}");
            health.second();
        }
        assert_eq!(health.code(), 1 << 10);
        health.clear(Conditions::FAILSAFE);
        assert_eq!(health.code(), 0);
    }

    #[test]
    fn the_cause_of_a_reset_is_told_for_a_minute_and_what_happens_then_for_ten_seconds() {
        for (fault_at, clear_at) in [(None, 60), (Some(5), 60), (Some(55), 66), (Some(70), 60)] {
            let mut health = Health::new();
            health.start(ResetCause::BROWN_OUT);
            let seconds = (0..100).filter(|&second| {
                if fault_at == Some(second) {
                    health.happened(Conditions::BUS_OFF);
                }
                let is_told = health.code() & Conditions::RESET.code() == 2;
                health.second();
                is_told
            });
            assert_eq!(seconds.count(), clear_at, "{fault_at:?}");
        }
    }

    /// Or else anybody could keep the node at WARNING with half a transfer every nine seconds.
    #[test]
    fn transfers_that_others_break_prolong_no_other_condition() {
        let mut health = Health::new();
        health.happened(Conditions::BUS_OFF);
        for second in 0..30 {
            health.happened(Conditions::TRANSFER_ERRORS);
            assert_eq!(health.has(Conditions::BUS_OFF), second < 11, "{second}");
            assert!(health.has(Conditions::TRANSFER_ERRORS));
            health.second();
        }
    }

    #[test]
    fn a_counter_wraps_around() {
        let mut counter = 65_534;
        count(&mut counter);
        count(&mut counter);
        assert_eq!(counter, 0);
    }
}
