use super::*;
use crate::desk::Servos;
use crate::dialect::segment;
use crate::golden;
use crate::monitor::Event;
use crate::parts::outputs::travel::CommandType;
use crate::tables::parameters::{OutputParameter, Parameter};
use crate::tables::wire::{Receiver, Transfer};
use dronecan_wire::Verdict;

/// The outputs, their servos, and the parameters.
struct Rig {
    outputs: Outputs,
    servos: Servos,
    parameters: Parameters,
    now_ms: u16,
}

impl Rig {
    fn new(values: &[(Parameter, i32)]) -> Self {
        let parameters = golden::parameters(values);
        let mut outputs = Outputs::new();
        outputs.start(&parameters);
        outputs.update(&parameters);
        Self { outputs, servos: Servos([0; OUTPUTS], [false; OUTPUTS]), parameters, now_ms: 0 }
    }

    /// Gives the outputs a message in one frame, and follows what waits then. Returns the line for
    /// the last result, with its values.
    fn message(
        &mut self,
        id: u32,
        payload: &[u8],
        act: impl Fn(&mut Outputs, &Transfer, &Parameters) -> Line,
    ) -> (Line, Event) {
        let frame = golden::frame(id, &[payload, &[0xC0]].concat());
        let mut receiver = Receiver::new();
        let segment = segment(&frame, 120).unwrap();
        let slot_of = |id| self.outputs.slot_of(id);
        let Verdict::Message(command) = receiver.accept_entries(segment, slot_of, 0) else {
            panic!()
        };
        let command = *command;
        let mut line = act(&mut self.outputs, &command, &self.parameters);
        let mut event = Event::new(Line::Running);
        while self.outputs.has_entry() {
            let (parameters, servos) = (&self.parameters, &mut self.servos);
            line = self.outputs.follow_next(&mut event, self.now_ms, parameters, servos).line;
        }
        (line, event)
    }

    /// The same for an ArrayCommand.
    fn command(&mut self, payload: &[u8]) -> (Line, Event) {
        self.message(0x1003_F20A, payload, Outputs::act_on_array_command)
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
            if self.outputs.tick(self.now_ms, &self.parameters) {
                assert_eq!(began.replace(n), None, "once");
            }
        }
        began
    }
}

#[test]
fn a_command_sets_the_pulse_of_node_and_servo_and_is_logged() {
    for (payload, unit, a, pulse) in [
        ([1, 0, 0x00, 0x38], CommandType::Unitless, 500, 3500),
        ([1, 0, 0x00, 0xBC], CommandType::Unitless, -1000i16 as u16, 2000),
        // A quarter of a radian.
        ([1, 1, 0x00, 0x34], CommandType::Position, 250, 3318),
        ([1, 4, 0x08, 0x67], CommandType::Pwm, 1800, 3600),
    ] {
        let mut rig = Rig::new(&[]);
        let (logged, event) = rig.command(&payload);
        assert_eq!((logged, event.b), (unit.line(), pulse), "{payload:02X?}");
        assert!(event.a == a || cfg!(not(feature = "values")), "{payload:02X?}");
        assert_eq!((rig.outputs.pulse(0), rig.servos.0[0]), (pulse, pulse), "{payload:02X?}");
        assert!(rig.outputs.each[0].is_following());
        assert_eq!(rig.outputs.hears_nothing(), OUTPUTS == 1, "several still follow");
    }
}

#[test]
fn commands_that_are_rejected_or_for_others_change_no_pulse() {
    let mut rig = Rig::new(&[]);
    rig.pwm(1700.0);
    rig.servos.0[0] = 0;
    for (payload, line) in [
        (&[1, 2, 0, 0x3C][..], Line::RefusedType),
        (&[1, 5, 0, 0x3C], Line::RefusedType),
        (&[1, 0, 0xFF, 0x7F], Line::RefusedValue),
        (&[1, 4, 0, 0], Line::RefusedValue),
        (&[2, 0, 0, 0x38], Line::NONE),
        (&[], Line::NONE),
    ] {
        assert_eq!(rig.command(payload).0, line, "{payload:02X?}");
        assert_eq!((rig.outputs.pulse(0), rig.servos.0[0]), (3400, 0), "{payload:02X?}");
        assert!(!rig.outputs.hears_nothing(), "{payload:02X?}");
    }
}

#[test]
fn the_failsafe_begins_after_the_timeout_once_and_goes_where_out1_fs_says() {
    for (failsafe, pulse) in [(0, 3600), (1, 2800), (2, 2200), (3, 0)] {
        for timeout_ms in [1, 250, 10_000] {
            let mut rig = Rig::new(&[
                (OutputParameter::Fs.of(0), failsafe),
                (OutputParameter::Timeout.of(0), timeout_ms),
                (OutputParameter::Trim.of(0), 1400),
                (OutputParameter::FsPwm.of(0), 1100),
            ]);
            rig.now_ms = 65_000;
            assert_eq!(rig.run(20_000), None, "before the first command");
            rig.pwm(1800.0);
            // The command may have come at the end of its millisecond.
            assert_eq!(rig.run(30_000), Some(timeout_ms as u16 + 1), "{failsafe}");
            assert_eq!(
                (rig.outputs.pulse(0), rig.outputs.each[0].is_following()),
                (pulse, false),
                "{failsafe}"
            );
            rig.pwm(1700.0);
            assert_eq!(
                (rig.outputs.pulse(0), rig.outputs.each[0].is_following()),
                (3400, true),
                "commands again"
            );
        }
    }
}

#[cfg(feature = "safety")]
mod safety {
    use super::*;

    const SAFE: u8 = 0;
    const ARMED: u8 = 255;

    impl Rig {
        fn tell(&mut self, status: u8) {
            self.outputs.act_on_safety_state(10, status, self.now_ms, &self.parameters);
        }
    }

    #[test]
    fn once_armed_commands_are_followed_and_missed_if_they_were_before() {
        for (was_commanded, is_failsafe, begins) in
            [(true, false, Some(101)), (true, true, Some(101)), (false, false, None)]
        {
            let mut rig = Rig::new(&[(OutputParameter::Timeout.of(0), 100)]);
            if was_commanded {
                rig.pwm(1800.0);
            }
            if is_failsafe {
                assert_eq!(rig.run(200), Some(101));
            }
            // The second one changes nothing.
            rig.tell(SAFE);
            rig.tell(SAFE);
            rig.run(500);
            rig.tell(ARMED);
            assert!(!rig.outputs.safety.is_safe());
            assert_eq!(rig.run(300), begins, "{was_commanded} {is_failsafe}");
            assert_eq!(rig.pwm(1200.0), CommandType::Pwm.line());
        }
    }

    #[test]
    fn a_safety_state_of_armed_restarts_no_failsafe_where_none_was_safe() {
        let mut rig = Rig::new(&[(OutputParameter::Timeout.of(0), 100)]);
        rig.pwm(1800.0);
        rig.run(60);
        rig.tell(ARMED);
        assert_eq!(rig.run(100), Some(41), "armed all the time");
    }
}
