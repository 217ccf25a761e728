//! The outputs together: which commands they follow, and when they require an armed vehicle.

use super::actuator::Actuator;
#[cfg(feature = "standard")]
use super::parameters::Parameter;
use super::parameters::Parameters;
#[cfg(all(feature = "draft", not(feature = "outputs")))]
use super::servo::CommandType;
use super::servo::{Output, Ticks};
#[cfg(not(feature = "outputs"))]
use super::wire::Transfer;
use crate::hardware::OUTPUTS;
use crate::monitor::{Event, Line};

#[cfg(not(feature = "outputs"))]
mod one;
#[cfg(feature = "outputs")]
mod several;

#[cfg(not(feature = "outputs"))]
use one::Several;
#[cfg(feature = "outputs")]
use several::Several;

/// The vehicle counts as disarmed after this time without an ArmingStatus, in seconds. ArduPilot
/// sends two a second.
#[cfg(feature = "standard")]
const ARMING_TIMEOUT_S: u8 = 4;

/// The safety switch counts as on for this time after a SafetyState that says so, in seconds.
/// ArduPilot sends two a second.
#[cfg(feature = "safety")]
const SAFETY_TIMEOUT_S: u8 = 4;

/// The outputs.
pub struct Actuators {
    each: [Actuator; OUTPUTS],
    /// What only a node with several outputs needs.
    several: Several,
    /// True if an ArrayCommand came after the last followed command.
    hears_commands: bool,
    /// Seconds that the vehicle still counts as armed.
    armed_s: u8,
    /// Seconds that the safety switch still counts as on.
    #[cfg(feature = "safety")]
    safe_s: u8,
}

impl Actuators {
    /// Outputs that give no pulse yet.
    pub const fn new() -> Self {
        Self {
            each: [Actuator::NONE; OUTPUTS],
            several: Several::new(),
            hears_commands: false,
            armed_s: 0,
            #[cfg(feature = "safety")]
            safe_s: 0,
        }
    }

    /// Applies the parameters of the travel, also to the pulses.
    pub fn update(&mut self, parameters: &Parameters) {
        for output in 0..self.used() {
            self.each[place(output)].update(output, parameters);
        }
        self.several.update(parameters);
    }

    /// Width of an output's pulse; 0 for none.
    pub fn pulse(&self, output: usize) -> Ticks {
        self.each[place(output)].pulse()
    }

    /// True from a followed command until the failsafe.
    pub fn is_following(&self, output: usize) -> bool {
        self.each[place(output)].is_following()
    }

    /// The outputs in use.
    #[inline(always)]
    fn used(&self) -> usize {
        self.several.used()
    }

    /// The position that an output's pulse asks for, in radians as a float16; NaN without a pulse.
    #[inline(always)]
    pub fn position(&self, output: usize) -> u16 {
        self.each[place(output)].position()
    }

    /// Gives the pulses to the outputs of the board.
    #[inline(always)]
    pub fn show(&mut self, board: &mut impl Output) {
        if !self.several.take_stale() {
            return;
        }
        for output in 0..self.used() {
            board.set(output, self.each[place(output)].pulse());
        }
        board.commit();
    }

    /// True if no ArrayCommand came after the last followed command, not even one for other
    /// actuators.
    pub fn hears_nothing(&self) -> bool {
        !self.hears_commands
    }

    /// True if ARM_REQ requires an armed vehicle, and the vehicle is disarmed.
    #[inline(never)]
    pub fn is_disarmed(&self, parameters: &Parameters) -> bool {
        #[cfg(feature = "standard")]
        return self.armed_s == 0 && parameters.is_on(Parameter::ArmReq);
        #[cfg(not(feature = "standard"))]
        return {
            let _ = parameters;
            false
        };
    }

    /// True if the last ArmingStatus said that the vehicle is armed.
    #[cfg(feature = "update")]
    pub fn is_armed(&self) -> bool {
        self.armed_s != 0
    }

    /// True if an output followed a command less than `time_ms` ago.
    #[cfg(feature = "update")]
    pub fn has_followed_within(&self, time_ms: u16, now_ms: u16) -> bool {
        self.each.iter().any(|actuator| actuator.has_followed_within(time_ms, now_ms))
    }

    /// Takes an ArmingStatus.
    #[cfg(feature = "standard")]
    #[inline(always)]
    pub fn arm(&mut self, status: u8) {
        const FULLY_ARMED: u8 = 255;
        self.armed_s = if status == FULLY_ARMED { ARMING_TIMEOUT_S } else { 0 };
    }

    /// True while the safety switch is on.
    #[inline(always)]
    pub fn is_safe(&self) -> bool {
        #[cfg(feature = "safety")]
        return self.safe_s != 0;
        #[cfg(not(feature = "safety"))]
        return false;
    }

    /// Takes a SafetyState. While it says safe, silence is expected, and the outputs do what
    /// SAFE_MODE says. `is_failsafe`: commands are missing.
    #[cfg(feature = "safety")]
    pub fn take_safety_state(
        &mut self,
        status: u8,
        is_failsafe: bool,
        now_ms: u16,
        parameters: &Parameters,
    ) {
        const SAFE: u8 = 0;
        if status != SAFE {
            return self.end_safe(now_ms);
        }
        let was_safe = self.is_safe();
        self.safe_s = SAFETY_TIMEOUT_S;
        for (output, actuator) in self.each.iter_mut().enumerate() {
            if !was_safe {
                actuator.begin_safe(self.several.is_failing(output, is_failsafe));
            }
            if parameters.is_on(Parameter::SafeMode) {
                actuator.stop();
            } else {
                self.several.stop_motor(output, actuator);
            }
        }
        self.several.touch();
    }

    /// From now on commands are expected again, if they were before.
    #[cfg(feature = "safety")]
    fn end_safe(&mut self, now_ms: u16) {
        if self.safe_s != 0 {
            self.safe_s = 0;
            for actuator in &mut self.each {
                actuator.end_safe(now_ms);
            }
        }
    }

    /// Takes an ArrayCommand: its entry for this node, if there is one.
    #[cfg(not(feature = "outputs"))]
    #[inline(always)]
    #[allow(clippy::too_many_arguments, reason = "it is inlined")]
    pub fn take_array_command(
        &mut self,
        command: &Transfer,
        _entry_len: u8,
        _has_backlog: impl FnOnce() -> bool,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        board: &mut impl Output,
    ) -> Line {
        self.hears_commands = true;
        let &[_, b1, b2, b3, ..] = command.bytes();
        if command.len() == 0 {
            return Line::CommandElsewhere;
        }
        // An entry of the draft has no command type.
        #[cfg(feature = "draft")]
        if command.len() == 3 {
            let value = u16::from_le_bytes([b1, b2]);
            return self.take_command(
                CommandType::Unitless as u8,
                value,
                event,
                now_ms,
                parameters,
                board,
            );
        }
        self.take_command(b1, u16::from_le_bytes([b2, b3]), event, now_ms, parameters, board)
    }

    /// Takes a command: a command type, and its value as a float16.
    #[cfg(not(feature = "outputs"))]
    #[inline(always)]
    fn take_command(
        &mut self,
        unit: u8,
        value: u16,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        board: &mut impl Output,
    ) -> Line {
        match self.each[0].pulse_of_command(unit, value, event) {
            Err(refusal) => refusal,
            Ok((pulse, line)) => {
                if let Some(line) = self.blocked(parameters) {
                    return line;
                }
                self.follow(0, pulse, event, now_ms, board);
                line
            }
        }
    }

    /// Takes the thesis's command, which is for the first output: 0 to 255 over the full travel.
    #[inline(always)]
    pub fn take_servo_command(
        &mut self,
        position: u8,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        board: &mut impl Output,
    ) -> Line {
        if self.several.is_motor(0) {
            return Line::RefusedType;
        }
        if let Some(line) = self.blocked(parameters) {
            return line;
        }
        self.follow(0, self.each[0].pulse_of_byte(position), event, now_ms, board);
        board.commit();
        Line::CommandThesis
    }

    /// The line for the reason to reject all commands, if there is one.
    #[inline(always)]
    fn blocked(&self, parameters: &Parameters) -> Option<Line> {
        #[cfg(feature = "standard")]
        if self.is_disarmed(parameters) {
            return Some(Line::RefusedDisarmed);
        }
        #[cfg(feature = "safety")]
        if self.is_safe() {
            return Some(Line::RefusedSafe);
        }
        let _ = parameters;
        None
    }

    /// Sets an output's pulse. The caller has found that nothing [blocks](Self::blocked) it.
    #[inline(always)]
    fn follow(
        &mut self,
        output: usize,
        pulse: Ticks,
        event: &mut Event,
        now_ms: u16,
        board: &mut impl Output,
    ) {
        board.set(output, pulse);
        self.each[place(output)].follow(pulse, now_ms);
        self.several.follow(output);
        self.hears_commands = false;
        event.b = pulse;
    }

    /// Starts the failsafe of each output when it is due. Call once a millisecond. Returns true if
    /// it starts because no command was followed for OUTn_TIMEOUT.
    #[inline(always)]
    pub fn tick(&mut self, now_ms: u16, parameters: &Parameters) -> bool {
        let mut begins = false;
        for output in self.several.tick() {
            let is_motor = self.several.is_motor(output);
            if self.each[place(output)].is_following() {
                let is_late =
                    self.each[place(output)].is_late(output, is_motor, now_ms, parameters);
                // A motor needs an armed vehicle, whatever ARM_REQ says.
                let is_disarmed =
                    if is_motor { self.armed_s == 0 } else { self.is_disarmed(parameters) };
                if is_late || is_disarmed {
                    self.fail_output(output, parameters);
                    self.several.touch();
                }
                begins |= is_late;
                if is_late {
                    self.several.fail(output);
                }
            }
        }
        begins
    }

    /// Has each output do what OUTn_FS says, until the next command.
    pub fn fail_safe(&mut self, parameters: &Parameters) {
        for output in 0..OUTPUTS {
            self.fail_output(output, parameters);
        }
        self.several.touch();
    }

    /// Has an output do what OUTn_FS says, and a motor stop, until the next command.
    #[inline(always)]
    fn fail_output(&mut self, output: usize, parameters: &Parameters) {
        let actuator = &mut self.each[place(output)];
        if !self.several.stop_motor(output, actuator) {
            actuator.fail_safe(output, parameters);
        }
    }

    /// Counts down the timeouts of ArmingStatus and SafetyState. Call once a second.
    #[inline(always)]
    pub fn second(&mut self, now_ms: u16) {
        self.armed_s = self.armed_s.saturating_sub(1);
        #[cfg(feature = "safety")]
        match self.safe_s {
            0 => {}
            1 => self.end_safe(now_ms),
            _ => self.safe_s -= 1,
        }
        let _ = now_ms;
    }
}

/// The place of an output in a table. Outputs beyond the last do not occur, and the compiler cannot
/// know that.
#[inline(always)]
#[allow(clippy::unnecessary_min_or_max, reason = "a build may have one output")]
fn place(output: usize) -> usize {
    output.min(OUTPUTS - 1)
}

impl Default for Actuators {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
