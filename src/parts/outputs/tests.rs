//! When the failsafe begins, to the millisecond. `tests/boards/failsafe.rs` has what it does.

use super::*;
use crate::desk::Servos;
use crate::dialect::segment;
use crate::golden;
use crate::image::InMemory;
use crate::monitor::Event;
use crate::tables::parameters::OutputParameter;
use crate::tables::wire::{Receiver, Transfer};
use dronecan_wire::Verdict;

/// The outputs and the parameters.
struct Rig {
    outputs: Outputs,
    parameters: Parameters,
    now_ms: u16,
}

impl Rig {
    /// Outputs of which the first has this timeout, and a command that waits.
    fn waiting(timeout_ms: i32) -> Self {
        let parameters = golden::parameters(&[(OutputParameter::Timeout.of(0), timeout_ms)]);
        let mut outputs = Outputs::new();
        outputs.start(&parameters);
        outputs.update(&parameters);
        let mut rig = Self { outputs, parameters, now_ms: 65_000 };
        assert_eq!(rig.run(20_000), None, "before the first command");
        let command = rig.received(0x1003_F20A, &[1, 4, 0x08, 0x67, 0xC0]);
        rig.outputs.act_on_array_command(&command, &rig.parameters);
        assert!(rig.outputs.has_entry());
        rig
    }

    /// The same outputs, which followed the command just before the clock wraps.
    fn commanded(timeout_ms: i32) -> Self {
        let mut rig = Self::waiting(timeout_ms);
        assert_eq!(rig.follow()[0], 3600, "1800 us");
        rig
    }

    /// The transfer of a frame.
    fn received(&self, id: u32, data: &[u8]) -> Transfer {
        let frame = golden::frame(id, data);
        let mut receiver = Receiver::new();
        let slot_of = |id| self.outputs.slot_of(id);
        match receiver.accept_entries(segment(&frame, 120).unwrap(), slot_of, 0) {
            Verdict::Message(command) => *command,
            _ => panic!("no command"),
        }
    }

    /// Follows the entry that waits. Returns what the outputs got.
    fn follow(&mut self) -> [Ticks; OUTPUTS] {
        let mut servos = Servos([0; OUTPUTS], [false; OUTPUTS]);
        let mut event = Event::new(Line::Running);
        self.outputs.follow_next(&mut event, self.now_ms, &self.parameters, &mut servos);
        servos.0
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

/// The command may have come at the end of its millisecond.
#[test]
fn the_failsafe_begins_in_the_millisecond_after_the_timeout_once() {
    for timeout_ms in [1, 250, 10_000] {
        let began = Rig::commanded(timeout_ms).run(30_000);
        assert_eq!(began, Some(timeout_ms as u16 + 1), "a timeout of {timeout_ms} ms");
    }
}

#[cfg(feature = "safety")]
#[test]
fn a_safety_state_of_armed_restarts_no_failsafe_where_none_was_safe() {
    const ARMED: u8 = 255;
    let mut rig = Rig::commanded(100);
    rig.run(60);
    rig.outputs.act_on_safety_state(10, ARMED, rig.now_ms, &rig.parameters);
    assert_eq!(rig.run(100), Some(41), "armed all the time");
}

/// It is for the old ID.
#[test]
fn a_command_that_waits_is_forgotten_with_the_id_of_its_output() {
    let mut rig = Rig::waiting(100);
    assert!(rig.parameters.set(OutputParameter::Id.index(0), 5, InMemory));
    rig.outputs.update(&rig.parameters);
    assert!(!rig.outputs.has_entry(), "an entry for ID 1 waits, and output 1 has ID 5 now");
}

/// The levels that pins were set to.
#[cfg(feature = "relay")]
impl Pulses for Vec<(usize, bool)> {
    fn set(&mut self, _: usize, _: Ticks) {}

    fn set_level(&mut self, output: usize, is_high: bool) {
        self.push((output, is_high));
    }
}

/// Each has its turn once in eight calls.
#[cfg(feature = "relay")]
#[test]
fn only_the_pins_of_relays_get_a_level_and_one_that_is_a_servo_again_becomes_low_once() {
    use crate::tables::parameters::Parameter;
    let types = [OutputParameter::Type.of(1), OutputParameter::Type.of(6)];
    let start = [(Parameter::OutCount, 8), (Parameter::RelayStart, 1 << 1)];
    let values = [start, types.map(|relay| (relay, 2))].concat();
    let mut parameters = golden::parameters(&values);
    let (mut outputs, mut levels) = (Outputs::new(), Vec::new());
    outputs.start(&parameters);
    outputs.update(&parameters);
    (0..16).for_each(|_| outputs.show(&mut levels));
    assert_eq!(levels.split_off(0), [(1, true), (6, false)].repeat(2), "outputs 2 and 7");
    assert!(parameters.set(types[0].index(), 0, InMemory));
    outputs.update(&parameters);
    (0..16).for_each(|_| outputs.show(&mut levels));
    assert_eq!(levels, [(1, false), (6, false), (6, false)], "output 2 is a servo again");
}

/// An esc.RawCommand for it waits, or the last one left it out.
#[cfg(feature = "outputs")]
#[test]
fn a_servo_that_was_a_motor_follows_its_own_command_and_keeps_it() {
    use crate::tables::parameters::Parameter;
    for command in [&[0xFF, 0x7C, 0xFF, 0x7C, 0xC0][..], &[0xFF, 0x7C, 0xC0]] {
        let mut rig = Rig::commanded(0);
        let mut set = |index, value| assert!(rig.parameters.set(index, value, InMemory));
        set(Parameter::OutCount.index(), 2);
        set(OutputParameter::Type.index(0), 1);
        set(OutputParameter::Id.index(0), 0);
        set(OutputParameter::Type.index(1), 1);
        set(OutputParameter::Id.index(1), 1);
        rig.outputs.start(&rig.parameters);
        rig.outputs.update(&rig.parameters);
        rig.outputs.act_on_arming_status(10, 255);
        let command = rig.received(0x0704_060A, command);
        rig.outputs.act_on_raw_command(&command, &rig.parameters);
        let mut set = |index, value| assert!(rig.parameters.set(index, value, InMemory));
        set(OutputParameter::Type.index(1), 0);
        set(OutputParameter::Id.index(1), 8);
        set(OutputParameter::Fs.index(1), 1);
        rig.outputs.update(&rig.parameters);
        let command = rig.received(0x1003_F20A, &[8, 4, 0x08, 0x67, 0xC1]);
        rig.outputs.act_on_array_command(&command, &rig.parameters);
        while rig.outputs.has_entry() {
            rig.follow();
        }
        rig.run(20);
        assert_eq!(rig.outputs.pulse(1), 3600, "1800 us");
    }
}
