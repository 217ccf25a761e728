//! A node with one output.

use super::super::actuator::Actuator;
use super::super::parameters::Parameters;
use super::Actuators;

/// Nothing: there is one output.
pub struct Several;

impl Several {
    /// The only value.
    pub const fn new() -> Self {
        Self
    }

    /// Does nothing.
    pub fn update(&mut self, _parameters: &Parameters) {}

    /// The only output is in use.
    #[inline(always)]
    pub fn used(&self) -> usize {
        1
    }

    /// True: the board gets the pulse each millisecond, because it ends pulses only between two of
    /// them.
    #[inline(always)]
    pub fn take_stale(&mut self) -> bool {
        true
    }

    /// The only output.
    #[inline(always)]
    pub fn tick(&mut self) -> core::ops::Range<usize> {
        0..1
    }

    /// Does nothing.
    pub fn touch(&mut self) {}

    /// Does nothing.
    pub fn follow(&mut self, _output: usize) {}

    /// True if the output is in failsafe, as the node's health says.
    #[cfg(feature = "safety")]
    pub fn is_failing(&self, _output: usize, is_failsafe: bool) -> bool {
        is_failsafe
    }

    /// Does nothing.
    pub fn fail(&mut self, _output: usize) {}

    /// False: the output is a servo.
    #[inline(always)]
    pub fn is_motor(&self, _output: usize) -> bool {
        false
    }

    /// Does nothing, and returns false: the output is a servo.
    #[inline(always)]
    pub fn stop_motor(&self, _output: usize, _actuator: &mut Actuator) -> bool {
        false
    }
}

impl Actuators {
    /// True if the failsafe has ended.
    pub fn has_recovered(&self) -> bool {
        self.is_following(0)
    }

    /// The output of the next actuator.Status.
    #[cfg(feature = "standard")]
    #[inline(always)]
    pub fn next_to_report(&mut self) -> Option<usize> {
        Some(0)
    }
}
