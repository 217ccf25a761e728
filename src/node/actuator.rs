//! The servo output: which commands it follows, when it requires an armed vehicle, and what it does when commands stop.

use dronecan_wire::float16;

use super::parameters::{Parameter, Parameters};
use super::servo::{CommandType, Output, Ticks, Travel};
use super::wire::Transfer;
use crate::monitor::{Event, Line};

/// The vehicle counts as disarmed after this time without an ArmingStatus, in seconds. ArduPilot sends two a second.
#[cfg(feature = "standard")]
const ARMING_TIMEOUT_S: u8 = 4;

/// The safety switch counts as on for this time after a SafetyState that says so, in seconds. ArduPilot sends two a second.
#[cfg(feature = "safety")]
const SAFETY_TIMEOUT_S: u8 = 4;

/// OUT1_FS: what the output does when commands stop. 3 ends the pulses.
mod failsafe {
    /// Holds the pulse.
    pub const HOLD: u8 = 0;
    /// Goes to OUT1_TRIM.
    pub const TRIM: u8 = 1;
    /// Goes to OUT1_FS_PWM.
    pub const PWM: u8 = 2;
}

/// The servo output.
pub struct Actuator {
    travel: Travel,
    pulse: Ticks,
    /// True from a followed command until the failsafe.
    is_following: bool,
    /// Time of the last followed command, in milliseconds.
    followed_ms: u16,
    /// True if an ArrayCommand came after the last followed command.
    hears_commands: bool,
    /// Seconds that the vehicle still counts as armed.
    armed_s: u8,
    /// Seconds that the safety switch still counts as on.
    #[cfg(feature = "safety")]
    safe_s: u8,
    /// The output was following commands, or missing them, when the safety switch was put on.
    #[cfg(feature = "safety")]
    was_following: bool,
}

impl Actuator {
    /// An actuator that gives no pulse yet.
    pub const fn new() -> Self {
        Self {
            travel: Travel::NONE,
            pulse: 0,
            is_following: false,
            followed_ms: 0,
            hears_commands: false,
            armed_s: 0,
            #[cfg(feature = "safety")]
            safe_s: 0,
            #[cfg(feature = "safety")]
            was_following: false,
        }
    }

    /// Applies the parameters of the travel, also to the pulse.
    pub fn update(&mut self, parameters: &Parameters) {
        self.travel.update(parameters);
        if self.pulse != 0 {
            self.pulse = self.travel.limit(self.pulse);
        }
    }

    /// Width of the pulse; 0 for none.
    pub fn pulse(&self) -> Ticks {
        self.pulse
    }

    /// True from a followed command until the failsafe.
    pub fn is_following(&self) -> bool {
        self.is_following
    }

    /// True if no ArrayCommand came after the last followed command, not even one for other actuators.
    pub fn hears_nothing(&self) -> bool {
        !self.hears_commands
    }

    /// The position that the pulse asks for, in radians as a float16; NaN without a pulse.
    #[inline(always)]
    pub fn position(&self) -> u16 {
        if self.pulse == 0 { float16::NAN } else { self.travel.position(self.pulse) }
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

    /// True if a command was followed less than `time_ms` ago.
    #[cfg(feature = "update")]
    pub fn has_followed_within(&self, time_ms: u16, now_ms: u16) -> bool {
        self.is_following && now_ms.wrapping_sub(self.followed_ms) < time_ms
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

    /// Takes a SafetyState. While it says safe, silence is expected, and the output does what SAFE_MODE says. `is_failsafe`: commands are missing.
    #[cfg(feature = "safety")]
    pub fn take_safety_state(&mut self, status: u8, is_failsafe: bool, now_ms: u16, parameters: &Parameters) {
        const SAFE: u8 = 0;
        if status != SAFE {
            return self.end_safe(now_ms);
        }
        if self.safe_s == 0 {
            self.was_following = core::mem::take(&mut self.is_following) || is_failsafe;
        }
        self.safe_s = SAFETY_TIMEOUT_S;
        if parameters.is_on(Parameter::SafeMode) {
            self.pulse = 0;
        }
    }

    /// From now on commands are expected again, if they were before.
    #[cfg(feature = "safety")]
    fn end_safe(&mut self, now_ms: u16) {
        if self.safe_s != 0 {
            self.safe_s = 0;
            self.is_following = self.was_following;
            self.followed_ms = now_ms;
        }
    }

    /// Takes an ArrayCommand: its entry for this output, if there is one.
    #[inline(always)]
    pub fn take_array_command(
        &mut self,
        command: &Transfer,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        servo: &mut impl Output,
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
            return self.take_command(CommandType::Unitless as u8, value, event, now_ms, parameters, servo);
        }
        self.take_command(b1, u16::from_le_bytes([b2, b3]), event, now_ms, parameters, servo)
    }

    /// Takes a command for this output: a command type, and its value as a float16.
    #[inline(always)]
    fn take_command(
        &mut self,
        unit: u8,
        value: u16,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        servo: &mut impl Output,
    ) -> Line {
        let Some(unit) = CommandType::new(unit) else { return Line::RefusedType };
        if !float16::is_finite(value) {
            return Line::RefusedValue;
        }
        let value = float16::to_fixed(value, unit.fraction_bits());
        let pulse = self.travel.pulse(unit, value);
        if pulse == 0 {
            return Line::RefusedValue;
        }
        // The log has microseconds for PWM (`value` has halves), and thousandths for the others: `value` has 2^14 to 1, or 2^12 to a radian.
        let mut logged = value >> 1;
        let mut line = Line::CommandPwm;
        if unit != CommandType::Pwm {
            line = Line::CommandPosition;
            if unit == CommandType::Unitless {
                line = Line::CommandUnitless;
                logged >>= 2;
            }
            // Converts 1024ths to thousandths: 1 - 3/128 is 1000/1024. No product overflows.
            logged >>= 1;
            logged -= (logged * 3) >> 7;
        }
        event.a = logged as u16;
        self.follow(pulse, line, event, now_ms, parameters, servo)
    }

    /// Takes the thesis's command: 0 to 255 over the full travel.
    #[inline(always)]
    pub fn take_servo_command(
        &mut self,
        position: u8,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        servo: &mut impl Output,
    ) -> Line {
        let pulse = self.travel.pulse_of_byte(position);
        self.follow(pulse, Line::CommandThesis, event, now_ms, parameters, servo)
    }

    /// Sets a pulse, unless the vehicle has to be armed and is not.
    #[inline(always)]
    fn follow(
        &mut self,
        pulse: Ticks,
        line: Line,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        servo: &mut impl Output,
    ) -> Line {
        #[cfg(feature = "standard")]
        if self.is_disarmed(parameters) {
            return Line::RefusedDisarmed;
        }
        #[cfg(feature = "safety")]
        if self.is_safe() {
            return Line::RefusedSafe;
        }
        let _ = parameters;
        servo.set(pulse);
        self.pulse = pulse;
        self.is_following = true;
        self.hears_commands = false;
        self.followed_ms = now_ms;
        event.b = pulse;
        line
    }

    /// Starts the failsafe when it is due. Call once a millisecond. Returns true if it starts because no command was followed for OUT1_TIMEOUT.
    #[inline(always)]
    pub fn tick(&mut self, now_ms: u16, parameters: &Parameters) -> bool {
        if !self.is_following {
            return false;
        }
        let timeout_ms = parameters.get(Parameter::Out1Timeout);
        let is_late = timeout_ms != 0 && now_ms.wrapping_sub(self.followed_ms) >= timeout_ms;
        if is_late || self.is_disarmed(parameters) {
            self.fail_safe(parameters);
        }
        is_late
    }

    /// Does what OUT1_FS says, until the next command.
    #[inline(never)]
    pub fn fail_safe(&mut self, parameters: &Parameters) {
        self.is_following = false;
        self.pulse = match parameters.get(Parameter::Out1Fs) as u8 {
            failsafe::HOLD => return,
            failsafe::TRIM => self.travel.trim(),
            failsafe::PWM => self.travel.limit(parameters.get(Parameter::Out1FsPwm) << 1),
            _ => 0,
        };
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

impl Default for Actuator {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::desk::Servo;
    use crate::golden;
    use crate::node::wire::{Receiver, segment};
    use dronecan_wire::Verdict;

    /// An actuator, its servo, and its parameters.
    struct Rig {
        actuator: Actuator,
        servo: Servo,
        parameters: Parameters,
        now_ms: u16,
    }

    impl Rig {
        fn new(values: &[(Parameter, i32)]) -> Self {
            let parameters = golden::parameters(values);
            let mut actuator = Actuator::new();
            actuator.update(&parameters);
            Self { actuator, servo: Servo(0), parameters, now_ms: 0 }
        }

        /// Gives the actuator an ArrayCommand in one frame. The receiver keeps the entries for actuator 1.
        fn command(&mut self, payload: &[u8]) -> (Line, Event) {
            let frame = golden::frame(0x1003_F20A, &[payload, &[0xC0]].concat());
            let mut receiver = Receiver::new();
            let Verdict::Message(command) = receiver.accept(segment(&frame, 120).unwrap(), 1, 0, 0) else { panic!() };
            let mut event = Event::new(Line::Running);
            let (parameters, servo) = (&self.parameters, &mut self.servo);
            (self.actuator.take_array_command(command, &mut event, self.now_ms, parameters, servo), event)
        }

        fn pwm(&mut self, width: f32) -> Line {
            let [low, high] = half::f16::from_f32(width).to_le_bytes();
            self.command(&[1, 4, low, high]).0
        }

        /// Runs for `ms` milliseconds. Returns how many had passed when the failsafe began.
        fn run(&mut self, ms: u16) -> Option<u16> {
            let mut began = None;
            for n in 1..=ms {
                self.now_ms = self.now_ms.wrapping_add(1);
                if self.actuator.tick(self.now_ms, &self.parameters) {
                    assert_eq!(began.replace(n), None, "once");
                }
            }
            began
        }
    }

    #[test]
    fn a_command_sets_the_pulse_of_node_and_servo_and_is_logged() {
        for (payload, line, a, pulse) in [
            ([1, 0, 0x00, 0x38], Line::CommandUnitless, 500, 3500),
            ([1, 0, 0x00, 0xBC], Line::CommandUnitless, -1000i16 as u16, 2000),
            // A quarter of a radian.
            ([1, 1, 0x00, 0x34], Line::CommandPosition, 250, 3318),
            ([1, 4, 0x08, 0x67], Line::CommandPwm, 1800, 3600),
        ] {
            let mut rig = Rig::new(&[]);
            let (logged, event) = rig.command(&payload);
            assert_eq!((logged, event.a, event.b), (line, a, pulse), "{payload:02X?}");
            assert_eq!((rig.actuator.pulse(), rig.servo.0), (pulse, pulse), "{payload:02X?}");
            assert!(rig.actuator.is_following() && rig.actuator.hears_nothing());
        }
    }

    #[test]
    fn commands_that_are_rejected_or_for_others_change_no_pulse() {
        let mut rig = Rig::new(&[]);
        rig.pwm(1700.0);
        rig.servo.0 = 0;
        for (payload, line) in [
            (&[1, 2, 0, 0x3C][..], Line::RefusedType),
            (&[1, 5, 0, 0x3C], Line::RefusedType),
            (&[1, 0, 0xFF, 0x7F], Line::RefusedValue),
            (&[1, 4, 0, 0], Line::RefusedValue),
            (&[2, 0, 0, 0x38], Line::CommandElsewhere),
            (&[], Line::CommandElsewhere),
        ] {
            assert_eq!(rig.command(payload).0, line, "{payload:02X?}");
            assert_eq!((rig.actuator.pulse(), rig.servo.0), (3400, 0), "{payload:02X?}");
            assert!(!rig.actuator.hears_nothing(), "{payload:02X?}");
        }
    }

    #[test]
    fn the_thesis_command_goes_over_the_travel() {
        let mut rig = Rig::new(&[]);
        for (byte, pulse) in [(0, 2000), (255, 4000), (51, 2400)] {
            let mut event = Event::new(Line::Running);
            let line = rig.actuator.take_servo_command(byte, &mut event, 0, &rig.parameters, &mut rig.servo);
            assert_eq!((line, event.b, rig.servo.0), (Line::CommandThesis, pulse, pulse));
        }
    }

    #[test]
    fn the_failsafe_begins_after_the_timeout_once_and_goes_where_out1_fs_says() {
        for (failsafe, pulse) in [(0, 3600), (1, 2800), (2, 2200), (3, 0)] {
            for timeout_ms in [1, 250, 10_000] {
                let mut rig = Rig::new(&[
                    (Parameter::Out1Fs, failsafe),
                    (Parameter::Out1Timeout, timeout_ms),
                    (Parameter::Out1Trim, 1400),
                    (Parameter::Out1FsPwm, 1100),
                ]);
                rig.now_ms = 65_000;
                assert_eq!(rig.run(20_000), None, "before the first command");
                rig.pwm(1800.0);
                assert_eq!(rig.run(30_000), Some(timeout_ms as u16), "{failsafe}");
                assert_eq!((rig.actuator.pulse(), rig.actuator.is_following()), (pulse, false), "{failsafe}");
                rig.pwm(1700.0);
                assert_eq!((rig.actuator.pulse(), rig.actuator.is_following()), (3400, true), "commands again");
            }
        }
    }

    #[test]
    fn with_a_timeout_of_0_there_is_no_failsafe() {
        let mut rig = Rig::new(&[(Parameter::Out1Timeout, 0), (Parameter::Out1Fs, 3)]);
        rig.pwm(1800.0);
        for _ in 0..4 {
            assert_eq!(rig.run(50_000), None);
        }
        assert_eq!(rig.actuator.pulse(), 3600);
    }

    #[test]
    fn the_position_is_unknown_without_a_pulse_and_else_that_of_the_command() {
        let mut rig = Rig::new(&[]);
        assert!(half::f16::from_bits(rig.actuator.position()).is_nan());
        rig.pwm(2000.0);
        let position = half::f16::from_bits(rig.actuator.position()).to_f64();
        assert!((position - std::f64::consts::FRAC_PI_4).abs() < 0.001, "{position}");
    }

    #[cfg(feature = "standard")]
    #[test]
    fn arming_times_out_at_the_fourth_second() {
        let mut rig = Rig::new(&[(Parameter::ArmReq, 1), (Parameter::Out1Fs, 3)]);
        assert_eq!((rig.pwm(1800.0), rig.servo.0), (Line::RefusedDisarmed, 0));
        for status in [0, 1, 254] {
            rig.actuator.arm(255);
            assert!(!rig.actuator.is_disarmed(&rig.parameters));
            rig.actuator.arm(status);
            assert!(rig.actuator.is_disarmed(&rig.parameters), "{status}");
        }
        rig.actuator.arm(255);
        assert_eq!(rig.pwm(1800.0), Line::CommandPwm);
        for second in 1..=4 {
            assert_eq!(rig.actuator.pulse(), 3600, "{second}");
            rig.actuator.second(rig.now_ms);
            assert_eq!(rig.run(1), None, "disarmed is no failsafe");
        }
        assert_eq!((rig.actuator.pulse(), rig.actuator.is_following()), (0, false));
    }

    #[cfg(feature = "standard")]
    #[test]
    fn where_arming_is_not_required_nobody_is_disarmed() {
        assert!(!Rig::new(&[]).actuator.is_disarmed(&golden::parameters(&[])));
    }

    #[cfg(feature = "safety")]
    mod safety {
        use super::*;

        const SAFE: u8 = 0;
        const ARMED: u8 = 255;

        impl Rig {
            fn tell(&mut self, status: u8, is_failsafe: bool) {
                self.actuator.take_safety_state(status, is_failsafe, self.now_ms, &self.parameters);
            }
        }

        #[test]
        fn while_safe_there_is_no_pulse_or_the_last_one_and_silence_is_no_failsafe() {
            for (safe_mode, pulse) in [(0, 3600), (1, 0)] {
                let mut rig = Rig::new(&[(Parameter::SafeMode, safe_mode), (Parameter::Out1Timeout, 100)]);
                rig.pwm(1800.0);
                assert!(!rig.actuator.is_safe());
                rig.tell(SAFE, false);
                assert!(rig.actuator.is_safe());
                assert_eq!((rig.run(1000), rig.actuator.pulse()), (None, pulse));
                assert_eq!(rig.pwm(1200.0), Line::RefusedSafe);
                assert_eq!(rig.actuator.pulse(), pulse);
            }
        }

        #[test]
        fn once_armed_commands_are_followed_and_missed_if_they_were_before() {
            for (was_commanded, is_failsafe, begins) in
                [(true, false, Some(100)), (false, true, Some(100)), (false, false, None)]
            {
                let mut rig = Rig::new(&[(Parameter::Out1Timeout, 100)]);
                if was_commanded {
                    rig.pwm(1800.0);
                }
                // The second one changes nothing.
                rig.tell(SAFE, is_failsafe);
                rig.tell(SAFE, false);
                rig.run(500);
                rig.tell(ARMED, false);
                assert!(!rig.actuator.is_safe());
                assert_eq!(rig.run(300), begins, "{was_commanded} {is_failsafe}");
                assert_eq!(rig.pwm(1200.0), Line::CommandPwm);
            }
        }

        #[test]
        fn a_safety_state_of_armed_restarts_no_failsafe_where_none_was_safe() {
            let mut rig = Rig::new(&[(Parameter::Out1Timeout, 100)]);
            rig.pwm(1800.0);
            rig.run(60);
            rig.tell(ARMED, false);
            assert_eq!(rig.run(100), Some(40), "armed all the time");
        }

        #[test]
        fn safe_ends_in_the_fourth_second_without_a_safety_state() {
            let mut rig = Rig::new(&[(Parameter::Out1Timeout, 100)]);
            rig.pwm(1800.0);
            rig.tell(SAFE, false);
            for second in 1..=4 {
                assert!(rig.actuator.is_safe(), "{second}");
                assert_eq!(rig.run(1000), None, "silence is expected");
                rig.actuator.second(rig.now_ms);
            }
            assert!(!rig.actuator.is_safe());
            assert_eq!(rig.run(200), Some(100), "commands are missed again");
        }
    }
}
