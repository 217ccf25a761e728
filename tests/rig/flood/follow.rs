//! How the outputs follow the commands on the bus, seen from outside: at the compare register of
//! Timer1 if one output is in use, and at the pulses if several are.

use std::collections::VecDeque;

use bench::Cycles;
use bench::avr::Pulse;

use super::super::US;
use super::super::load::Samples;
use super::setup::Escs;
use super::source::Command;

/// A pulse may be off by two ticks: the value of a command is rounded twice.
const TOLERANCE: i32 = 2;
/// The same for an eighth of a pulse, which is rounded once more, in ticks of the whole.
const TOLERANCE_OF_EIGHTHS: i32 = TOLERANCE + 4 + 8;
/// The controller has a frame some bit times before the frame ends for the bus.
const END_OF_FRAME: Cycles = 4 * US;

/// A command on the bus.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    /// End of its last frame.
    ended: Cycles,
    /// The pulse that it asks for, in ticks of half a microsecond.
    pulse: i32,
    /// See [`Command::is_stop`].
    is_stop: bool,
}

impl Waiting {
    fn asks_for(&self, pulse: i32, tolerance: i32) -> bool {
        (self.pulse - pulse).abs() <= tolerance
    }
}

/// The commands for one output that are in no register yet.
#[derive(Default)]
pub struct Register {
    waiting: VecDeque<Waiting>,
    /// Number of commands that were written to the register.
    pub followed: u64,
    /// Number of received commands that a newer one replaced before they were followed.
    pub superseded: u64,
    /// Number of writes of values that no command had asked for.
    pub unasked: u64,
    /// Cycles from the end of each received command until the register had its value or that of a
    /// newer command.
    pub settled: Samples,
}

impl Register {
    /// A command's last frame ended.
    pub fn command(&mut self, ended: Cycles, Command { pulse, is_stop, .. }: Command) {
        self.waiting.push_back(Waiting { ended, pulse, is_stop });
    }

    /// The controller lost the frame that was complete at this time.
    pub fn lost(&mut self, at: Cycles) {
        self.waiting.retain(|waiting| waiting.ended.abs_diff(at) > END_OF_FRAME);
    }

    /// The register got this value, in ticks.
    pub fn written(&mut self, at: Cycles, pulse: i32) {
        let is_newest =
            |waiting: &Waiting| waiting.ended <= at && waiting.asks_for(pulse, TOLERANCE);
        let Some(newest) = self.waiting.iter().rposition(is_newest) else {
            self.unasked += 1;
            return;
        };
        self.followed += 1;
        self.superseded += newest as u64;
        for waiting in self.waiting.drain(..=newest) {
            self.settled.push(at - waiting.ended);
        }
    }

    /// Number of commands that are still in no register.
    pub fn left(&self) -> usize {
        self.waiting.len()
    }
}

/// The commands and pulses of one of several outputs.
#[derive(Default)]
pub struct Pulses {
    commands: VecDeque<Waiting>,
    /// Number of pulses.
    pub seen: u64,
    /// Number of pulses whose width no command had asked for.
    pub unasked: u64,
    /// For each pulse: cycles from the end of the oldest newer command to the beginning of the
    /// pulse; 0 if the newest command made the pulse. Nobody waits for a motor to stop that an
    /// esc.RawCommand leaves out.
    pub stale: Samples,
    /// For each pulse that a command made: cycles from the command's end to the beginning of the
    /// pulse.
    pub age: Samples,
    /// Time from the end of a command to that of the next, in cycles.
    pub intervals: Samples,
    last_command: Option<Cycles>,
    /// Widths of the pulses, and the time from the beginning of one to that of the next, in cycles.
    pub widths: Samples,
    pub periods: Samples,
    /// The pulses are eighths of those that the commands ask for.
    are_eighths: bool,
    last_start: Option<Cycles>,
}

impl Pulses {
    /// No pulse yet of an output that has these pulses.
    pub fn of(escs: Escs) -> Pulses {
        Pulses { are_eighths: escs == Escs::OneShot125, ..Pulses::default() }
    }

    /// A command's last frame ended.
    pub fn command(&mut self, ended: Cycles, Command { pulse, is_stop, .. }: Command) {
        if let Some(last) = self.last_command.replace(ended) {
            self.intervals.push(ended - last);
        }
        self.commands.push_back(Waiting { ended, pulse, is_stop });
    }

    /// The controller lost the frame that was complete at this time.
    pub fn lost(&mut self, at: Cycles) {
        self.commands.retain(|command| command.ended.abs_diff(at) > END_OF_FRAME);
    }

    /// A pulse ended.
    pub fn pulse(&mut self, pulse: &Pulse) {
        let (width, tolerance) = match self.are_eighths {
            true => (pulse.width_cycles as i32, TOLERANCE_OF_EIGHTHS),
            false => ((pulse.width_cycles / 8) as i32, TOLERANCE),
        };
        self.widths.push(pulse.width_cycles);
        if self.last_start.replace(pulse.start).is_some() {
            self.periods.push(pulse.period_cycles.unwrap_or(0));
        }
        let older = self.commands.partition_point(|command| command.ended <= pulse.start);
        if older == 0 {
            // It has not been commanded yet.
            return;
        }
        self.seen += 1;
        let is_of = |command: &Waiting| command.asks_for(width, tolerance);
        let Some(made_by) = self.commands.iter().take(older).rposition(is_of) else {
            self.unasked += 1;
            return;
        };
        if !self.commands[made_by].is_stop {
            self.age.push(pulse.start - self.commands[made_by].ended);
        }
        let newer = self.commands.range(made_by + 1..older).find(|command| !command.is_stop);
        self.stale.push(newer.map_or(0, |command| pulse.start - command.ended));
        // The one that made this pulse can make further ones.
        self.commands.drain(..made_by);
    }
}
