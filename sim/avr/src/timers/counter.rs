//! One Timer/Counter: the counter, its two compare units and their outputs, without registers.
//!
//! The three timers differ in width, modes and prescaler only, so this is the model of each. Time
//! is an argument: [`Counter::step`] goes from one event to the next, and the clocks between two
//! events, which only count, are skipped at once. All times are edges of the CPU clock.
//!
//! Source: Atmel 2545, sections 15.5 to 15.8 (Timer0), 16.7 to 16.10 (Timer1), 18.5 to 18.8
//! (Timer2). In the figures of "Timing Diagrams" a flag is set, an output changes, and a buffered
//! OCRnx is updated at the timer clock that follows the counter value that causes it.

use super::modes::{Kind, Mode, Top};
use sim_base::Cycles;

/// Flags of TIFRn, at the bits at which all three registers have them.
pub const TOV: u8 = 1 << 0;
/// Output compare flags; the one of channel B is one bit further left.
pub const OCFA: u8 = 1 << 1;
/// Input capture flag, of Timer1 only.
pub const ICF: u8 = 1 << 5;

/// Effects of one timer clock.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Step {
    /// Time of the clock.
    pub at: Cycles,
    /// Flags that it sets in TIFRn.
    pub flags: u8,
    /// For OCnA and OCnB: true if the clock changed the output register.
    pub changed: [bool; 2],
}

/// State of one compare unit.
#[derive(Debug, Clone, Copy, Default)]
struct Channel {
    /// The value that the program writes and reads.
    buffer: u16,
    /// The value that the comparator uses.
    ocr: u16,
    /// COMnx1:0.
    com: u8,
    /// The OCnx register: drives the pin while COMnx connects it.
    output: bool,
}

/// One Timer/Counter.
#[derive(Debug, Clone)]
pub struct Counter {
    /// Largest value of the counter (MAX).
    max: u16,
    mode: Mode,
    channels: [Channel; 2],
    icr: u16,
    count: u16,
    counts_down: bool,
    /// A write of TCNTn blocks the compare match of the next timer clock, even if the timer was
    /// stopped (section 15.5.2).
    match_blocked: bool,
    /// CPU cycles of a timer clock; 0: stopped.
    divider: u64,
    next_clock: Cycles,
}

impl Counter {
    /// A counter after a reset. `max` is 0xFF or 0xFFFF.
    pub fn new(max: u16) -> Counter {
        Counter {
            max,
            mode: Mode::normal(max),
            channels: Default::default(),
            icr: 0,
            count: 0,
            counts_down: false,
            match_blocked: false,
            divider: 0,
            next_clock: 0,
        }
    }

    /// Value of the counter.
    pub fn count(&self) -> u16 {
        self.count
    }

    /// Writes TCNTn. The direction of the counter does not change.
    pub fn set_count(&mut self, value: u16) {
        self.count = value & self.max;
        self.match_blocked = true;
    }

    /// Value of ICR1.
    pub fn icr(&self) -> u16 {
        self.icr
    }

    /// Writes ICR1, which is not buffered (section 16.9.3).
    pub fn set_icr(&mut self, value: u16) {
        self.icr = value;
    }

    /// Copies the counter to ICR1.
    pub fn capture(&mut self) {
        self.icr = self.count;
    }

    /// True if TOP is in ICR1.
    pub fn has_top_in_icr(&self) -> bool {
        self.mode.top == Top::Icr
    }

    /// Writes OCRnA (index 0) or OCRnB (1). In PWM modes the comparator gets the value at the next
    /// update only.
    pub fn set_ocr(&mut self, index: usize, value: u16) {
        self.channels[index].buffer = value & self.max;
        if !self.mode.kind.is_pwm() {
            self.channels[index].ocr = value & self.max;
        }
    }

    /// Sets the mode and both values of COMnx1:0.
    pub fn configure(&mut self, mode: Mode, com: [u8; 2]) {
        self.mode = mode;
        for (channel, com) in self.channels.iter_mut().zip(com) {
            channel.com = com;
        }
        if !mode.kind.is_pwm() {
            self.load_buffers();
        }
        if !mode.kind.has_two_slopes() {
            self.counts_down = false;
        }
    }

    /// Sets the clock: CPU cycles of a timer clock, 0 to stop; and the phase of the prescaler, a
    /// time at which it was 0. The first clock comes after `at`.
    pub fn set_clock(&mut self, divider: u64, prescaler_zero: Cycles, at: Cycles) {
        self.divider = divider;
        if divider != 0 {
            self.next_clock = at + divider - (at - prescaler_zero) % divider;
        }
    }

    /// CPU cycles of a timer clock; 0: stopped.
    pub fn divider(&self) -> u64 {
        self.divider
    }

    /// Forces a compare match (FOCnx). Works in modes without PWM only; sets no flag and does not
    /// clear the counter (section 15.5.1).
    pub fn force_compare(&mut self, index: usize) {
        if !self.mode.kind.is_pwm() {
            self.match_output(index);
        }
    }

    /// The level that the compare unit drives; `None` if COMnx does not connect it.
    pub fn output(&self, index: usize) -> Option<bool> {
        self.is_connected(index).then_some(self.channels[index].output)
    }

    /// True if OCnx overrides the port (tables 15-2 to 15-7, 16-1 to 16-3, 18-2 to 18-7).
    pub fn is_connected(&self, index: usize) -> bool {
        match self.channels[index].com {
            0 => false,
            1 if self.mode.kind.is_pwm() => index == 0 && self.mode.toggles_a,
            _ => true,
        }
    }

    /// Performs the timer clocks up to and including `to`, but returns after the first one that
    /// sets a flag or changes an output. `None`: there was none.
    pub fn step(&mut self, to: Cycles) -> Option<Step> {
        if self.divider == 0 {
            return None;
        }
        while self.next_clock <= to {
            let uneventful = u64::from(self.clocks_to_event());
            if uneventful > 0 {
                let due = (to - self.next_clock) / self.divider + 1;
                let skipped = due.min(uneventful);
                // At most 65535: `uneventful` was a u16.
                let counts = skipped as u16;
                self.count =
                    if self.counts_down { self.count - counts } else { self.count + counts };
                self.next_clock += skipped * self.divider;
                continue;
            }
            let at = self.next_clock;
            self.next_clock += self.divider;
            let step = self.clock(at);
            if step.flags != 0 || step.changed != [false; 2] {
                return Some(step);
            }
        }
        None
    }

    /// Time before which no clock sets a flag or changes an output; `None` if the timer stands.
    pub fn next_event(&self) -> Option<Cycles> {
        let clocks = u64::from(self.clocks_to_event());
        (self.divider != 0).then_some(self.next_clock + clocks * self.divider)
    }

    /// Number of timer clocks that only count, before one that turns, wraps or matches.
    fn clocks_to_event(&self) -> u16 {
        if self.match_blocked {
            return 0;
        }
        let from = self.count;
        let [a, b] = self.channels.each_ref().map(|channel| channel.ocr);
        if self.counts_down {
            [a, b, 0].into_iter().filter(|stop| *stop <= from).map(|stop| from - stop).min()
        } else {
            let stops = [a, b, self.top(), self.max];
            stops.into_iter().filter(|stop| *stop >= from).map(|stop| stop - from).min()
        }
        .unwrap_or(0)
    }

    fn top(&self) -> u16 {
        match self.mode.top {
            Top::Fixed(top) => top,
            Top::Icr => self.icr,
            Top::Ocra => self.channels[0].ocr,
        }
    }

    /// Performs one timer clock.
    fn clock(&mut self, at: Cycles) -> Step {
        let outputs = self.channels.map(|channel| channel.output);
        let blocked = std::mem::take(&mut self.match_blocked);
        let matches = self.channels.map(|channel| channel.ocr == self.count && !blocked);
        // > Do not write the TCNT1 equal to TOP in PWM modes with variable TOP values. The compare
        // > match for the TOP will be ignored and the counter will continue to 0xFFFF. (section
        // > 16.7.3)
        let is_top =
            self.count == self.top() && !(blocked && !matches!(self.mode.top, Top::Fixed(_)));
        let mut flags = (u8::from(matches[0]) | u8::from(matches[1]) << 1) * OCFA;
        if is_top && self.mode.top == Top::Icr && !self.counts_down {
            flags |= ICF;
        }
        flags |= match self.mode.kind {
            Kind::Normal | Kind::Ctc => self.clock_single(is_top, matches),
            Kind::FastPwm => self.clock_fast(is_top, matches),
            Kind::PhaseCorrect | Kind::PhaseAndFrequencyCorrect => {
                self.clock_both_ways(is_top, blocked, matches)
            }
        };
        let changed = std::array::from_fn(|index| self.channels[index].output != outputs[index]);
        Step { at, flags, changed }
    }

    /// A clock in Normal or CTC mode. TOV is set at MAX (table 15-8).
    fn clock_single(&mut self, is_top: bool, matches: [bool; 2]) -> u8 {
        for index in (0..2).filter(|index| matches[*index]) {
            self.match_output(index);
        }
        let is_max = self.count == self.max;
        self.count = if is_top || is_max { 0 } else { self.count + 1 };
        u8::from(is_max) * TOV
    }

    /// A clock in fast PWM mode. TOV is set at TOP, OCRnx updated at BOTTOM.
    fn clock_fast(&mut self, is_top: bool, matches: [bool; 2]) -> u8 {
        let wraps = is_top || self.count == self.max;
        for (index, is_match) in matches.into_iter().enumerate() {
            match self.channels[index].com {
                2 | 3 if wraps => self.channels[index].output = self.channels[index].com == 2,
                _ if is_match => self.match_output(index),
                _ => {}
            }
        }
        if wraps {
            self.load_buffers();
        }
        self.count = if wraps { 0 } else { self.count + 1 };
        u8::from(is_top) * TOV
    }

    /// A clock in one of the modes that count up and down. TOV is set at BOTTOM. OCRnx is updated
    /// at TOP (phase correct) or at BOTTOM (phase and frequency correct).
    fn clock_both_ways(&mut self, is_top: bool, blocked: bool, matches: [bool; 2]) -> u8 {
        let turns_down = is_top && !self.counts_down;
        // > Similarly, do not write the TCNT1 value equal to BOTTOM when the counter is
        // > downcounting. (section 16.7.3) This model then misses BOTTOM, as it misses a TOP.
        let turns_up = self.counts_down && self.count == 0 && !blocked;
        if turns_down || turns_up {
            self.counts_down = turns_down;
        }
        for index in (0..2).filter(|index| matches[*index]) {
            self.match_output(index);
        }
        match self.mode.kind {
            Kind::PhaseCorrect if turns_down => {
                self.load_buffers();
                self.restore_symmetry();
            }
            Kind::PhaseAndFrequencyCorrect if turns_up => self.load_buffers(),
            _ => {}
        }
        self.count = match self.counts_down {
            _ if self.count == 0 && self.top() == 0 => 0,
            true => self.count.wrapping_sub(1) & self.max,
            false => self.count.wrapping_add(1) & self.max,
        };
        u8::from(turns_up) * TOV
    }

    /// At TOP the output has the level that a match while counting up gives it, even if there was
    /// none: the old OCRnx was TOP, or the counter started above OCRnx (section 15.7.4).
    fn restore_symmetry(&mut self) {
        let top = self.top();
        for channel in self.channels.iter_mut().filter(|channel| channel.ocr < top) {
            match channel.com {
                2 => channel.output = false,
                3 => channel.output = true,
                _ => {}
            }
        }
    }

    /// Changes an output at a compare match: toggles, clears or sets it. Counting down exchanges
    /// clear and set.
    fn match_output(&mut self, index: usize) {
        if self.is_connected(index) {
            let channel = &mut self.channels[index];
            channel.output = match channel.com {
                1 => !channel.output,
                2 => self.counts_down,
                _ => !self.counts_down,
            };
        }
    }

    fn load_buffers(&mut self) {
        for channel in &mut self.channels {
            channel.ocr = channel.buffer;
        }
    }
}
