//! The whole node: takes frames and milliseconds, gives frames and a pulse.

use super::*;
use crate::desk::{Desk as Rig, Memory};
use crate::golden;
use crate::image::InMemory;
use crate::tables::parameters::OutputParameter;
use mcp2515_ordered::Frame;

mod manage;
#[cfg(feature = "outputs")]
mod outputs;

impl Memory {
    /// An EEPROM with these parameters saved.
    fn with(values: &[(Parameter, i32)]) -> Self {
        let mut memory = Self::blank();
        let mut store = Store::new();
        assert!(!store.load(&mut Parameters::new(), &memory, InMemory));
        let mut parameters = golden::parameters(values);
        store.save();
        while store.is_saving() {
            store.step(&mut parameters, &mut memory, InMemory);
        }
        assert!(store.is_saved());
        memory
    }
}

#[allow(dead_code, reason = "a build may have no test that needs one")]
impl Rig {
    fn new() -> Self {
        Self::with(&[])
    }

    fn with(values: &[(Parameter, i32)]) -> Self {
        let mut rig = Self::start(Memory::with(values), ResetCause::POWER_ON);
        rig.settle();
        rig
    }

    /// Sets a parameter, without the bus.
    fn set(&mut self, parameter: Parameter, value: i32) {
        assert!(self.program.node.parameters.set(parameter.index(), value, InMemory));
        self.program.node.apply_parameters();
        self.settle();
    }

    /// Runs for `ms` milliseconds.
    fn run(&mut self, ms: u32) {
        for _ in 0..ms {
            self.pass(1);
        }
    }

    fn frames(&mut self, frames: &[Frame]) {
        for frame in frames {
            self.frame(frame);
        }
    }

    /// Receives a frame. Asserts that the servo gets the pulse at once if a command was followed,
    /// and nothing otherwise.
    fn frame(&mut self, frame: &Frame) {
        let followed = self.program.node.health().counts.followed;
        self.servos.0[0] = 0;
        self.hear(frame);
        let is_followed = self.program.node.health().counts.followed != followed;
        assert_eq!(self.servos.0[0], if is_followed { self.program.node.pulse(0) } else { 0 });
    }

    /// Receives the frames of one transfer, written as for [`golden::frames`].
    fn text(&mut self, text: &str) {
        self.frames(&golden::frames(text));
    }

    /// The vendor-specific status code.
    fn code(&self) -> u16 {
        self.program.node.health().code()
    }

    /// The current health.
    fn level(&self) -> u8 {
        health::Health::level(
            self.code(),
            &self.program.node.parameters,
            self.program.node.control.outputs.excused(self.now_ms()),
        ) as u8
    }

    /// Receives a command of a pulse width in microseconds, for actuator 1 from node 10.
    fn command(&mut self, width_us: f32) {
        let [low, high] = half::f16::from_f32(width_us).to_le_bytes();
        self.frames(&[golden::frame(0x1003_F20A, &[1, 4, low, high, 0xC0])]);
    }

    fn status_of(&mut self, source: u32) {
        self.frames(&[golden::frame(0x1001_5500 | source, &[1, 0, 0, 0, 0, 0, 0, 0xC0])]);
    }

    /// The frames sent with this identifier.
    fn sent(&self, id: u32) -> Vec<Frame> {
        let sent = self.can.sent.iter().map(|(_, frame)| *frame);
        sent.filter(|frame| golden::id(frame) == id).collect()
    }

    /// The transfers sent with this identifier: the time of the last frame, the payload and the
    /// transfer ID.
    fn transfers(&self, id: u32, signature: u64) -> Vec<(u32, Vec<u8>, u8)> {
        let mut transfers = vec![];
        let mut frames = vec![];
        for (ms, frame) in self.can.sent.iter().filter(|(_, frame)| golden::id(frame) == id) {
            frames.push(*frame);
            if frame.data().last().unwrap() & 0x40 != 0 {
                let (payload, transfer_id) = golden::payload(signature, &frames);
                transfers.push((*ms, payload, transfer_id));
                frames.clear();
            }
        }
        assert!(frames.is_empty(), "a transfer without end");
        transfers
    }

    /// Times of the node's statuses.
    fn status_times(&self) -> Vec<u32> {
        self.transfers(NODE_STATUS, 0).into_iter().map(|(ms, ..)| ms).collect()
    }
}

/// Identifiers of the messages of node 120.
const NODE_STATUS: u32 = 0x1801_5578;
#[cfg(feature = "standard")]
const ACTUATOR_STATUS: u32 = 0x1803_F378;
const TEMPERATURE: u32 = 0x1804_5678;
#[cfg(feature = "stats")]
const CAN_STATS: u32 = 0x1801_5778;
/// The rates of all messages that have one.
fn rates(telemetry: i32, temperature: i32, stats: i32) -> Vec<(Parameter, i32)> {
    let _ = (telemetry, stats);
    vec![
        #[cfg(feature = "standard")]
        (Parameter::TelemRate, telemetry),
        (Parameter::TempRate, temperature),
        #[cfg(feature = "stats")]
        (Parameter::StatsRate, stats),
    ]
}

/// The messages that have a rate, in the same order: identifier and signature.
const PACED: &[(u32, u64)] = &[
    #[cfg(feature = "standard")]
    (ACTUATOR_STATUS, golden::ACTUATOR_STATUS),
    (TEMPERATURE, 0),
    #[cfg(feature = "stats")]
    (CAN_STATS, golden::CAN_STATS),
];

/// Converts microseconds to ticks.
fn us(us: f64) -> Ticks {
    (us * 2.0) as Ticks
}

fn gaps(times: &[u32]) -> Vec<u32> {
    times.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

/// The gaps between the node's statuses while an autopilot sends one every `period` ms.
fn gaps_with_an_autopilot_every(period: u32) -> Vec<u32> {
    let mut rig = Rig::new();
    for _ in 0..30_000 / period {
        rig.status_of(10);
        rig.run(period);
    }
    gaps(&rig.status_times())
}

#[test]
fn statuses_are_500_to_1025_ms_apart_however_often_the_autopilot_sends_its_own() {
    for period in [
        1, 2, 10, 100, 249, 250, 251, 333, 499, 500, 501, 600, 999, 1000, 1001, 1024, 1026, 1100,
        1250, 1500, 1524, 1525, 2000, 2200, 2999,
    ] {
        let gaps = gaps_with_an_autopilot_every(period);
        assert!(gaps.len() >= 28, "{} every {period} ms", gaps.len());
        for gap in gaps {
            assert!((500..=1025).contains(&gap), "{gap} ms, every {period} ms");
        }
    }
}

#[test]
fn a_status_that_waits_in_the_controller_is_not_followed_by_another() {
    let mut rig = Rig::with(&rates(0, 0, 0));
    rig.run(100);
    rig.can.sent.clear();
    // The controller takes the frame and cannot send it for three seconds.
    rig.can.is_held = true;
    rig.run(3000);
    assert_eq!(rig.status_times().len(), 1);
    rig.can.sent.clear();
    rig.can.is_held = false;
    let left_ms = rig.ms;
    rig.run(5000);
    assert!(rig.status_times()[0] >= left_ms + 500, "{:?} after {left_ms}", rig.status_times());
    assert!(gaps(&rig.status_times()).iter().all(|&gap| gap >= 500));
}

/// ArduPilot leaves out channels without a pulse while it is disarmed, and does not arm while the
/// node is at ERROR.
#[cfg(feature = "standard")]
#[test]
fn a_missing_command_is_no_error_while_the_autopilot_says_that_it_is_disarmed() {
    for (status, level) in [(Some(0), 0), (Some(255), 2), (None, 2)] {
        let mut rig = Rig::new();
        rig.command(1500.0);
        for _ in 0..6 {
            if let Some(status) = status {
                rig.hear(&golden::frame(0x1804_4C0A, &[status, 0xC0]));
            }
            rig.run(500);
        }
        assert_eq!((rig.code(), rig.level()), (1 << 10, level), "{status:?}");
        rig.run(5000);
        assert_eq!(rig.level(), 2, "no ArmingStatus any more");
    }
}

#[test]
fn an_output_whose_id_changes_follows_nothing_that_a_list_has_for_the_old_one() {
    let mut rig = Rig::new();
    let entries = [1, 4, 0x08, 0x67].repeat(3);
    let frames = golden::transfer(0x1003_F20A, golden::ARRAY_COMMAND, 3, &entries);
    let (last, first) = frames.split_last().expect("several frames");
    rig.frames(first);
    let id = OutputParameter::Id.index(0);
    assert!(rig.program.node.parameters.set(id, 60, InMemory));
    rig.program.node.apply_parameters();
    rig.run(10);
    rig.frame(last);
    assert_eq!((rig.program.node.pulse(0), rig.program.node.health().counts.followed), (0, 0));
}

#[test]
fn each_rate_is_kept_and_even() {
    for rate in 0..=50u32 {
        let rates = rates(rate as i32, rate as i32, rate.min(10) as i32);
        let mut rig = Rig::with(&rates);
        rig.run(1000);
        rig.can.sent.clear();
        rig.run(10_000);
        for (&(id, signature), (_, rate)) in PACED.iter().zip(rates) {
            let rate = rate as u32;
            let times: Vec<u32> =
                rig.transfers(id, signature).into_iter().map(|(ms, ..)| ms).collect();
            assert_eq!(times.len() as u32, 10 * rate, "{id:08X} at {rate} Hz");
            for gap in gaps(&times) {
                assert!(
                    gap == 1000 / rate || gap == 1000_u32.div_ceil(rate),
                    "{id:08X} at {rate} Hz: {gap} ms"
                );
            }
        }
    }
}

#[cfg(feature = "stats")]
#[test]
fn the_golden_can_stats_are_sent() {
    let mut rig = Rig::with(&[(Parameter::StatsRate, 1)]);
    rig.can.counters.0 = [1, 2, 2, 3, 4, 5, 6, 7, 8, 8, 9, 10, 11];
    rig.run(1500);
    assert_eq!(
        golden::text(&rig.sent(CAN_STATS)),
        "18015778 73 A5 00 01 00 02 00 80 | 02 00 03 00 04 00 05 20 | 00 06 00 07 00 08 00 00 | \
         08 00 09 00 0A 00 60"
    );
}

#[test]
fn a_bus_that_takes_nothing_gets_each_message_once_when_it_does_again() {
    let mut rig = Rig::new();
    rig.run(1500);
    rig.can.sent.clear();
    rig.can.room = 0;
    rig.run(5000);
    assert_eq!(rig.can.sent, []);
    rig.can.room = u32::MAX;
    rig.run(1);
    // One that was ready, and one of each message that became due: no outdated messages.
    assert!(rig.can.sent.len() <= 2 + 1 + 2 + 1, "{:?}", rig.can.sent);
}

#[cfg(feature = "monitor")]
#[test]
fn the_serial_monitor_goes_on_while_what_is_due_has_to_wait() {
    let mut rig = Rig::new();
    // A second status that has to wait for half a second, and no temperature yet.
    rig.run(3);
    rig.status_of(10);
    rig.log.clear();
    rig.run(100);
    let log = String::from_utf8(rig.log.clone()).unwrap();
    assert!(log.contains("rx NodeStatus from 10"), "{log}");
}

#[test]
fn filters_wait_until_no_transfer_goes_out_for_four_seconds_at_most_and_for_none_that_comes_in() {
    let start = || {
        let mut rig = Rig::with(&rates(0, 0, 0));
        rig.run(1500);
        rig.command(1800.0);
        rig.run(990);
        rig
    };
    let first = golden::frames("1003F20B 12 F3 01 00 00 38 02 88").pop().unwrap();
    // They do not wait for the rest of what comes in.
    let mut rig = start();
    for _ in 0..4 {
        rig.frame(&first);
        rig.run(10);
    }
    assert_eq!(rig.can.filters_set, 1);
    let mut rig = start();
    rig.frame(&golden::frames("1E0BF8FF C5 16 00 01 2A 00 00 81")[0]);
    rig.run(45);
    assert_eq!(rig.can.filters_set, 1);
    // A controller that sends nothing.
    let mut rig = start();
    rig.can.is_held = true;
    rig.text("1E01F8FF C0");
    let mut waited_ms = 0;
    while rig.can.filters_set == 0 {
        rig.run(10);
        waited_ms += 10;
        assert!(waited_ms <= 4020);
    }
    assert!(waited_ms > 2000, "{waited_ms} ms");
}

/// 10 A for 36 seconds are 100 mAh. Both inputs of the circuit are at 2.5 V.
#[cfg(feature = "battery")]
#[test]
fn the_charge_of_a_time_without_measurements_is_not_known() {
    let mut rig = Rig::with(&[
        (Parameter::Pwr1VoltMult, 5000),
        (Parameter::Pwr1AmpPervlt, 400),
        (Parameter::BattRate, 1),
        (Parameter::BattCapacity, 1000),
    ]);
    rig.circuit = [512, 512];
    let charge_percent = |rig: &mut Rig| {
        rig.run(1000);
        let (_, payload, _) = rig.transfers(0x1804_4478, 0x249C_2654_8A71_1966).pop().unwrap();
        (payload[16] & 0x3F) << 1 | payload[17] >> 7
    };
    rig.run(35_000);
    assert_eq!(charge_percent(&mut rig), 90);
    rig.set(Parameter::BattRate, 0);
    rig.run(90_000);
    rig.set(Parameter::BattRate, 1);
    assert_eq!(charge_percent(&mut rig), 90);
}
