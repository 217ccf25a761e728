//! The output of a program with one output: Timer1 makes its pulse without software.

use super::chip::TC1;
use super::pins::ServoSignal;
use super::timer1;
use firmware::parts::outputs::Pulses;
use firmware::parts::outputs::travel::Ticks;
use firmware::tables::parameters::{Parameter, Parameters};

/// The servo output. It makes no pulse before the first [`set`](Pulses::set).
pub struct Outputs {
    tc1: TC1,
    signal: ServoSignal,
    width: Ticks,
}

impl Outputs {
    pub(super) fn new(tc1: TC1, signal: ServoSignal) -> Self {
        timer1::stop(&tc1, &signal);
        Self { tc1, signal, width: 0 }
    }

    /// Starts the timer, with OUT_RATE. Call it before the first pulse.
    pub fn start(&mut self, parameters: &Parameters) {
        timer1::set_period(&self.tc1, timer1::period(parameters.get(Parameter::OutRate)));
        timer1::run(&self.tc1);
    }
}

impl Pulses for Outputs {
    #[inline(never)]
    fn set(&mut self, _output: usize, width: Ticks) {
        // A pulse that has begun is not cut.
        if width != self.width && (width != 0 || !self.signal.is_driven_high()) {
            self.width = width;
            timer1::set_width(&self.tc1, width);
        }
    }
}

/// Waits until no output gives a pulse, before the program ends. Timer1 gives the only one, and
/// goes on.
pub fn finish() {}
