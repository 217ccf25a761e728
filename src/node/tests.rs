//! The whole node: takes frames and milliseconds, gives frames and a pulse.

use super::*;
use crate::desk::{Desk as Rig, Memory};
use crate::golden;
use crate::image::InMemory;
use crate::tables::parameters::OutputParameter;
use mcp2515_ordered::{Frame, Notice};
use std::f64::consts::FRAC_PI_4;

#[cfg(feature = "allocation")]
mod allocate;
#[cfg(feature = "battery")]
mod battery;
mod manage;
#[cfg(feature = "outputs")]
mod outputs;
#[cfg(feature = "relay")]
mod relays;
#[cfg(feature = "rpm")]
mod rpm;

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

    /// Receives a command for actuator 1 from node 10.
    fn command(&mut self, command_type: u8, value: f64) {
        let [low, high] = half::f16::from_f64(value).to_bits().to_le_bytes();
        self.frames(&[golden::frame(0x1003_F20A, &[1, command_type, low, high, 0xC0])]);
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

    /// The last status after another second: the byte of health and mode, and the vendor-specific
    /// code.
    fn status(&mut self) -> (u8, u16) {
        self.run(1000);
        let (_, payload, _) = self.transfers(NODE_STATUS, 0).pop().unwrap();
        (payload[4], u16::from_le_bytes([payload[5], payload[6]]))
    }
}

/// Identifiers of the messages of node 120.
const NODE_STATUS: u32 = 0x1801_5578;
#[cfg(feature = "standard")]
const ACTUATOR_STATUS: u32 = 0x1803_F378;
const TEMPERATURE: u32 = 0x1804_5678;
#[cfg(feature = "stats")]
const CAN_STATS: u32 = 0x1801_5778;
#[cfg(feature = "button")]
const KEY_VALUE: u32 = 0x183F_F278;

const UNITLESS: u8 = 0;
const POSITION: u8 = 1;
const PWM: u8 = 4;

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

// Status

#[test]
fn the_first_status_goes_at_once_and_says_initialization() {
    let mut rig = Rig::new();
    rig.run(1);
    assert_eq!(golden::text(&[rig.can.sent[0].1]), "18015578 00 00 00 00 08 00 00 C0");
}

#[test]
fn alone_on_the_bus_it_sends_its_status_every_second() {
    let mut rig = Rig::new();
    rig.run(70_001);
    let statuses = rig.transfers(NODE_STATUS, 0);
    assert_eq!(statuses.len(), 71);
    for (n, (ms, payload, transfer_id)) in statuses.into_iter().enumerate() {
        assert_eq!(ms, 1000 * n as u32);
        assert_eq!(usize::from(transfer_id), n % 32);
        let mode = if n == 0 { 8 } else { 0 };
        let uptime = u32::from_le_bytes(*payload.first_chunk().unwrap());
        assert!(uptime.abs_diff(n as u32) <= 1, "{uptime} s");
        assert_eq!(payload[4..], [mode, 0, 0]);
    }
}

#[test]
fn its_mode_is_operational_once_it_has_measured() {
    let mut rig = Rig::new();
    rig.run(10);
    rig.status_of(10);
    rig.run(600);
    rig.status_of(10);
    rig.run(1);
    let modes: Vec<u8> =
        rig.transfers(NODE_STATUS, 0).into_iter().map(|(_, payload, _)| payload[4]).collect();
    assert_eq!(modes, [8, 0]);
}

#[test]
fn its_status_follows_that_of_the_autopilot() {
    // The autopilot's period may also be slightly longer than a second.
    for period in [1000, 1001, 1010, 1024] {
        let mut rig = Rig::new();
        rig.run(300);
        // The first status of the autopilot comes less than 500 ms after the node's own, so the
        // node's next one waits until 500 ms.
        let mut expected = vec![0, 500];
        for _ in 0..60 {
            if rig.ms > 500 {
                expected.push(rig.ms);
            }
            rig.status_of(10);
            rig.run(period);
        }
        assert_eq!(rig.status_times(), expected, "every {period} ms");
    }
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
fn it_sends_every_second_again_when_the_autopilot_has_gone() {
    let mut rig = Rig::new();
    for _ in 0..5 {
        rig.status_of(10);
        rig.run(1000);
    }
    rig.run(20_000);
    for gap in gaps(&rig.status_times()) {
        assert!((500..=1025).contains(&gap), "{gap} ms");
    }
    assert_eq!(gaps(&rig.status_times()).last(), Some(&1000));
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

#[test]
fn uptime_counts_seconds_past_the_end_of_the_clock() {
    let mut rig = Rig::new();
    rig.run(200_000);
    let (ms, payload, _) = rig.transfers(NODE_STATUS, 0).pop().unwrap();
    assert_eq!(ms, 199_000);
    assert!(u32::from_le_bytes(*payload.first_chunk().unwrap()).abs_diff(199) <= 1);
}

#[test]
fn transfer_ids_count_for_each_type_by_itself() {
    let mut rig = Rig::with(&rates(7, 3, 2));
    rig.run(40_000);
    for &(id, signature) in [(NODE_STATUS, 0)].iter().chain(PACED) {
        let transfers = rig.transfers(id, signature);
        assert!(transfers.len() > 32);
        for (n, (_, _, transfer_id)) in transfers.into_iter().enumerate() {
            assert_eq!(usize::from(transfer_id), n % 32, "{id:08X}");
        }
    }
}

#[test]
fn messages_keep_their_rates_while_the_main_loop_counts_several_milliseconds_at_once() {
    for passed_ms in [1, 2, 5, 10] {
        let rates = rates(50, 7, 2);
        let mut rig = Rig::with(&rates);
        // Wait for the first temperature.
        rig.run(1000);
        rig.can.sent.clear();
        let begun = rig.ms;
        while rig.ms < begun + 10_000 {
            rig.pass(passed_ms);
        }
        for (&(id, signature), (parameter, rate)) in PACED.iter().zip(rates) {
            let (sent, asked) = (rig.transfers(id, signature).len(), 10 * rate as usize);
            assert!(
                sent.abs_diff(asked) <= 1,
                "{parameter:?}: {sent} instead of {asked}, {passed_ms} ms at once"
            );
        }
    }
}

// Health

#[cfg(feature = "masks")]
#[test]
fn health_is_that_of_the_worst_mask_that_a_condition_is_in() {
    const WARN: i32 = 1 << 6;
    for (warn, error, critical, health) in [
        (0, 0, 0, 0),
        (WARN, 0, 0, 1),
        (0, WARN, 0, 2),
        (WARN, WARN, 0, 2),
        (WARN, WARN, WARN, 3),
        (0, 0, WARN, 3),
        (0xFFFF ^ WARN, 0xFFFF ^ WARN, 0xFFFF ^ WARN, 0),
    ] {
        let mut rig = Rig::with(&[
            (Parameter::WarnMask, warn),
            (Parameter::ErrorMask, error),
            (Parameter::CritMask, critical),
        ]);
        rig.run(100);
        // EFLG with TXEP.
        let flags = Notice { event: mcp2515_ordered::Event::Flags, value: 1 << 4 };
        rig.program.node.notice(flags);
        assert_eq!(rig.status(), (health << 6, 1 << 6), "{warn:04X} {error:04X} {critical:04X}");
    }
}

#[test]
fn a_fault_that_reset_it_shows_for_a_minute() {
    for (number, cause) in (1..).zip([
        ResetCause::WATCHDOG,
        ResetCause::BROWN_OUT,
        ResetCause::PANIC,
        ResetCause::STRAY_INTERRUPT,
        ResetCause::STACK_COLLISION,
    ]) {
        let mut rig = Rig::start(Memory::with(&[]), cause);
        rig.run(58_900);
        assert_eq!(rig.status(), (0x40, number));
        rig.run(1200);
        assert_eq!(rig.status(), (0, 0));
    }
}

#[test]
fn temporary_conditions_show_for_ten_to_eleven_seconds() {
    use mcp2515_ordered::Event::{
        AnotherRate, Flags, GaveUpSending, Lost, NotAnswering, NotKeeping, NotStarting, Running,
    };
    // Bits of EFLG: RX0OVR 6, RX1OVR 7, TXBO 5.
    for (event, value, bit) in [
        (Flags, 0x40, 5),
        (Flags, 0x80, 5),
        (Flags, 0x20, 7),
        (GaveUpSending, 0, 8),
        (AnotherRate, 0, 8),
        (Lost, 0x80, 8),
        (NotAnswering, 0, 8),
        (NotKeeping, 0x2A, 8),
        (NotStarting, 0x80, 8),
    ] {
        for begin_ms in [3001, 3300, 3999] {
            let mut rig = Rig::new();
            rig.run(begin_ms);
            rig.program.node.notice(Notice { event, value });
            rig.run(10_000);
            assert_eq!(rig.code(), 1 << bit, "{event:?} at {begin_ms}");
            rig.run(1002);
            assert_eq!(rig.code(), 0, "{event:?} at {begin_ms}");
        }
    }
    let mut rig = Rig::new();
    rig.program.node.notice(Notice { event: Running, value: 0 });
    assert_eq!(rig.code(), 0);
}

#[test]
fn error_passive_shows_while_it_lasts() {
    use mcp2515_ordered::Event::Flags;
    let mut rig = Rig::new();
    for (eflg, code) in
        [(0x08, 1 << 6), (0x10, 1 << 6), (0x18, 1 << 6), (0x07, 0), (0x10, 1 << 6), (0, 0)]
    {
        rig.program.node.notice(Notice { event: Flags, value: eflg });
        rig.run(12_000);
        assert_eq!(rig.code(), code, "EFLG {eflg:02X}");
    }
}

/// Broken transfers; `None` in a build that does not count them.
fn broken(rig: &Rig) -> Option<u16> {
    #[cfg(feature = "stats")]
    return Some(rig.program.node.record.stats.broken());
    #[cfg(not(feature = "stats"))]
    {
        let _ = rig;
        None
    }
}

/// The count; `None` in a build that does not count.
fn if_counted(count: u16) -> Option<u16> {
    cfg!(feature = "stats").then_some(count)
}

#[test]
fn broken_and_interleaved_transfers_show_and_are_counted() {
    let mut rig = Rig::new();
    rig.run(2000);
    // The golden command with one bit wrong.
    rig.text("1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 64 68");
    assert_eq!((rig.code(), broken(&rig), rig.program.node.pulse(0)), (1 << 3, if_counted(1), 0));
    rig.run(10_001);
    assert_eq!(rig.code(), 0);
    for source in 0..=crate::tables::wire::LIST_LANES {
        // A transfer keeps its lane for 4 ms after its last frame.
        rig.run(4);
        rig.text(&format!("1003F2{:02X} 12 F3 01 00 00 38 02 88", 0x0A + source));
    }
    assert_eq!((rig.code(), broken(&rig), rig.program.node.pulse(0)), (1 << 3, if_counted(2), 0));
    let last = 0x0A + crate::tables::wire::LIST_LANES;
    rig.text(&format!("1003F2{last:02X} 00 00 BC 03 04 DC 65 68"));
    assert_eq!((rig.program.node.pulse(0), broken(&rig)), (us(1750.0), if_counted(2)));
}

#[test]
fn transfers_of_other_nodes_do_not_break_those_of_the_commander() {
    let mut rig = Rig::new();
    let frames = golden::frames("1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 65 68");
    rig.frames(&frames);
    rig.command(PWM, 1200.0);
    rig.frame(&frames[0]);
    for source in 0x0B..0x20 {
        rig.text(&format!("1003F2{source:02X} 12 F3 01 00 00 38 02 88"));
    }
    rig.frame(&frames[1]);
    assert_eq!(rig.program.node.pulse(0), us(1750.0));
}

#[test]
fn a_status_with_its_own_node_id_shows() {
    let mut rig = Rig::new();
    rig.run(2000);
    rig.text("10015578 01 00 00 00 08 00 00 C0");
    assert_eq!(
        (rig.code(), broken(&rig), rig.program.node.health().counts.refused),
        (1 << 4, if_counted(0), 1)
    );
}

#[test]
fn frames_of_no_use_are_rejected_and_are_no_error() {
    let mut rig = Rig::new();
    rig.run(2000);
    for text in ["1803F30A 00 C0", "9003F20A 01 00 00 38 C7", "1E01AAFF C3", "1003F20A"] {
        let refused = rig.program.node.health().counts.refused;
        rig.text(text);
        assert_eq!(rig.program.node.health().counts.refused, refused + 1, "{text}");
    }
    assert_eq!((rig.code(), rig.program.node.pulse(0)), (0, 0));
}

#[test]
fn a_temperature_out_of_range_shows() {
    // Averages below 1 and above 1022 mean a faulty sensor.
    for (readings, min, max, code, flags) in [
        ([51, 52], -40, 85, 0, 0),
        ([51, 52], 26, 85, 1 << 11, 2),
        ([51, 52], 25, 85, 0, 0),
        ([51, 52], -40, 24, 1 << 11, 1),
        ([51, 52], -40, 25, 0, 0),
        ([300, 300], -40, 85, 1 << 11, 1),
        ([0, 0], -40, 85, 1 << 11, 0),
        ([1023, 1023], -40, 85, 1 << 11, 1),
    ] {
        let mut rig = Rig::with(&[
            (Parameter::TempMin, min),
            (Parameter::TempMax, max),
            (Parameter::TempSensor, 2),
        ]);
        rig.readings = readings;
        rig.run(2500);
        assert_eq!(rig.code(), code, "{readings:?} {min} {max}");
        let (_, payload, _) = rig.transfers(TEMPERATURE, 0).pop().unwrap();
        assert_eq!(payload[4], flags, "{readings:?} {min} {max}");
        rig.readings = [200, 200];
        rig.set(Parameter::TempMax, 150);
        rig.set(Parameter::TempMin, -55);
        rig.run(1100);
        assert_eq!(rig.code(), 0, "and it passes");
    }
}

#[test]
fn lost_parameters_are_reported_and_a_blank_eeprom_is_not() {
    // The thesis build speaks the draft by default.
    let draft = if cfg!(feature = "standard") { 0 } else { Conditions::DRAFT.code() };
    let mut rig = Rig::start(Memory::blank(), ResetCause::POWER_ON);
    rig.run(2000);
    assert_eq!((rig.level(), rig.code()), (0, draft));
    let mut memory = Memory::with(&[(OutputParameter::Id.of(0), 9)]);
    for byte in &mut memory.cells[0x20..] {
        *byte ^= if *byte == 0xFF { 0 } else { 0x10 };
    }
    let mut rig = Rig::start(memory, ResetCause::POWER_ON);
    rig.run(2000);
    assert_eq!((rig.level(), rig.code()), (3, 1 << 13 | draft));
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Id.of(0)), 1, "the default");
}

// Commands

#[test]
fn there_is_no_pulse_before_the_first_command() {
    for failsafe in 0..=3 {
        let mut rig = Rig::with(&[(OutputParameter::Fs.of(0), failsafe)]);
        rig.run(70_000);
        assert_eq!(rig.program.node.pulse(0), 0);
        assert_eq!(rig.code(), 0);
    }
}

#[test]
fn the_golden_commands_move_the_servo() {
    let mut rig = Rig::new();
    rig.text("1003F20A 01 00 00 38 C7");
    assert_eq!(rig.program.node.pulse(0), us(1750.0));
    for (actuator, pulse) in [(1, 1750.0), (2, 1000.0), (3, 1500.0)] {
        let mut rig = Rig::with(&[(OutputParameter::Id.of(0), actuator)]);
        rig.text("1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 65 68");
        assert_eq!(rig.program.node.pulse(0), us(pulse), "actuator {actuator}");
    }
    // Position -0.25 rad: 0.25 / (pi / 4) of 500 us.
    rig.text("1003F20A 01 01 00 B4 CC");
    assert_eq!(rig.program.node.pulse(0), us(1341.0));
    // PWM 1800.
    rig.text("1003F20A 01 04 08 67 CD");
    assert_eq!(rig.program.node.pulse(0), us(1800.0));
}

#[test]
fn each_form_of_command_reaches_the_pulse() {
    let mut rig = Rig::new();
    for (command_type, value, expected) in [
        (UNITLESS, 0.0, 1500.0),
        (UNITLESS, 1.0, 2000.0),
        (UNITLESS, -1.0, 1000.0),
        (UNITLESS, 7.0, 2000.0),
        (UNITLESS, 65_504.0, 2000.0),
        (UNITLESS, -0.001, 1499.5),
        (POSITION, 0.0, 1500.0),
        (POSITION, FRAC_PI_4, 2000.0),
        (POSITION, -FRAC_PI_4, 1000.0),
        (POSITION, 65_504.0, 2000.0),
        (PWM, 1234.0, 1234.0),
        (PWM, 1000.5, 1000.5),
        (PWM, 65_504.0, 2000.0),
        (PWM, 1.0, 1000.0),
    ] {
        rig.command(command_type, value);
        assert_eq!(
            f64::from(rig.program.node.pulse(0)) / 2.0,
            expected,
            "type {command_type}: {value}"
        );
    }
}

#[test]
fn every_bit_pattern_of_a_command_leaves_the_pulse_within_the_travel() {
    let mut rig = Rig::new();
    rig.command(PWM, 1700.0);
    for command_type in 0..=5u8 {
        for bits in 0..=u16::MAX {
            let before = rig.program.node.pulse(0);
            let [low, high] = bits.to_le_bytes();
            rig.frames(&[golden::frame(0x1003_F20A, &[1, command_type, low, high, 0xC0])]);
            let value = half::f16::from_bits(bits);
            let is_followed = value.is_finite()
                && match command_type {
                    0 | 1 => true,
                    // Rounded to half a microsecond.
                    4 => value.to_f64() >= 0.25,
                    _ => false,
                };
            let pulse = rig.program.node.pulse(0);
            if is_followed {
                assert!(
                    (us(1000.0)..=us(2000.0)).contains(&pulse),
                    "{command_type} {bits:04X}: {pulse}"
                );
            } else {
                assert_eq!(pulse, before, "{command_type} {bits:04X}");
            }
        }
    }
}

/// ArduPilot leaves out channels without a pulse while it is disarmed, and does not arm while the
/// node is at ERROR.
#[cfg(feature = "standard")]
#[test]
fn a_missing_command_is_no_error_while_the_autopilot_says_that_it_is_disarmed() {
    for (status, level) in [(Some(0), 0), (Some(255), 2), (None, 2)] {
        let mut rig = Rig::new();
        rig.command(PWM, 1500.0);
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
fn commands_that_cannot_be_followed_are_refused_and_counted() {
    let mut rig = Rig::new();
    rig.command(PWM, 1700.0);
    for (n, text) in [
        "1003F20A 01 02 00 3C CE",
        "1003F20A 01 03 00 3C CE",
        "1003F20A 01 05 00 3C CE",
        "1003F20A 01 00 FF 7F CF",
        "1003F20A 01 00 00 7C CF",
        "1003F20A 01 01 00 FC CF",
        "1003F20A 01 04 00 00 D0",
        "1003F20A 01 04 DC E5 D0",
        "1003F20A 01 00 00 C0",
        "1003F20A 01 00 00 38 01 C0",
        "1804570A C0",
        "1804570A 01 02 C0",
        "18044C0A C0",
        "1001550A 01 00 00 00 C0",
        "1804390A 00 F8 C0",
    ]
    .into_iter()
    .enumerate()
    {
        rig.text(text);
        assert_eq!(
            (rig.program.node.pulse(0), rig.program.node.health().counts.refused),
            (us(1700.0), n as u16 + 1),
            "{text}"
        );
    }
    assert_eq!(rig.program.node.health().counts.followed, 1);
    #[cfg(feature = "lights")]
    assert_eq!(rig.program.node.light(), 0);
}

#[test]
fn commands_for_others_and_empty_lists_are_no_commands_and_no_errors() {
    let mut rig = Rig::new();
    rig.text("1003F20A C9");
    rig.text("1003F20A 02 00 00 38 C7");
    assert_eq!(
        (
            rig.program.node.pulse(0),
            rig.program.node.health().counts.refused,
            rig.program.node.health().counts.followed
        ),
        (0, 0, 0)
    );
}

#[test]
fn the_command_of_the_thesis_moves_the_servo_over_its_travel() {
    let mut rig = Rig::new();
    for (byte, pulse) in [(0, 1000.0), (255, 2000.0), (51, 1200.0)] {
        rig.text(&format!("18045701 {byte:02X} C0"));
        assert_eq!(rig.program.node.pulse(0), us(pulse));
    }
}

#[cfg(feature = "lights")]
#[test]
fn the_light_shows_the_brightest_colour_of_its_entry() {
    for (text, light) in [
        ("1804390A 00 F8 00 C1", 255),
        ("1804390A 00 00 1F C1", 255),
        ("1804390A 00 07 E0 C1", 255),
        ("1804390A 00 FF FF C1", 255),
        ("1804390A 00 00 00 C1", 0),
        // Red 1 of 31, green 2 of 63, blue 16 of 31.
        ("1804390A 00 08 50 C4", 132),
        // (7, blue), (0, green 42), (8, white)
        ("1804390A 68 6B 07 00 1F 00 05 82 | 40 08 FF FF 62", 173),
    ] {
        let mut rig = Rig::new();
        rig.text(text);
        assert_eq!(rig.program.node.light(), light, "{text}");
        rig.text("1804390A 05 F8 00 C0");
        rig.text("1804390A C0");
        assert_eq!(rig.program.node.light(), light, "another's light");
    }
}

#[cfg(feature = "lights")]
#[test]
fn light_never_gets_darker_as_a_colour_gets_brighter() {
    for (shift, levels) in [(11, 32), (5, 64), (0, 32u16)] {
        let mut rig = Rig::new();
        let mut last = 0;
        for level in 0..levels {
            let [high, low] = (level << shift).to_be_bytes();
            rig.frames(&[golden::frame(0x1804_390A, &[0, high, low, 0xC0])]);
            let light = rig.program.node.light();
            assert!(light >= last, "{level} of {levels}: {light}");
            assert!(
                (f64::from(light) - f64::from(level) * 255.0 / f64::from(levels - 1)).abs() < 8.0
            );
            last = light;
        }
        assert_eq!(last, 255);
    }
}

// Failsafe and arming

#[test]
fn without_commands_the_servo_goes_where_out1_fs_has_it() {
    for (failsafe, expected) in [(0, 1800.0), (1, 1400.0), (2, 1100.0), (3, 0.0)] {
        for timeout_ms in [1, 20, 1000, 10_000] {
            let mut rig = Rig::with(&[
                (OutputParameter::Fs.of(0), failsafe),
                (OutputParameter::Timeout.of(0), timeout_ms),
                (OutputParameter::Trim.of(0), 1400),
                (OutputParameter::FsPwm.of(0), 1100),
            ]);
            rig.run(61_234);
            rig.command(PWM, 1800.0);
            // A command may come at the end of its millisecond.
            rig.run(timeout_ms as u32 + 1);
            assert_eq!(
                (rig.program.node.pulse(0), rig.code()),
                (us(1800.0), 0),
                "{failsafe} {timeout_ms}"
            );
            rig.run(1);
            assert_eq!(
                (rig.program.node.pulse(0), rig.code()),
                (us(expected), 1 << 10),
                "{failsafe} {timeout_ms}"
            );
            rig.run(2500);
            assert_eq!((rig.program.node.pulse(0), rig.status()), (us(expected), (0x80, 1 << 10)));
            rig.command(PWM, 1700.0);
            assert_eq!((rig.program.node.pulse(0), rig.code()), (us(1700.0), 0), "commands again");
        }
    }
}

#[test]
fn the_failsafe_pulse_stays_within_the_travel() {
    for (width, expected) in [(500, 1000.0), (2400, 2000.0)] {
        let mut rig =
            Rig::with(&[(OutputParameter::Fs.of(0), 2), (OutputParameter::FsPwm.of(0), width)]);
        rig.command(PWM, 1800.0);
        rig.run(1002);
        assert_eq!(rig.program.node.pulse(0), us(expected));
    }
}

#[test]
fn with_a_timeout_of_0_the_servo_stays_for_ever() {
    let mut rig = Rig::with(&[(OutputParameter::Fs.of(0), 3), (OutputParameter::Timeout.of(0), 0)]);
    rig.command(PWM, 1800.0);
    rig.run(200_000);
    assert_eq!((rig.program.node.pulse(0), rig.code()), (us(1800.0), 0));
}

#[test]
fn only_followed_commands_prevent_the_failsafe() {
    for text in [
        "1003F20A 02 00 00 38 C7",
        "1003F20A 01 00 FF 7F CF",
        "1003F20A C9",
        "1001550A 01 00 00 00 00 00 00 C0",
    ] {
        let mut rig = Rig::with(&[(OutputParameter::Fs.of(0), 3)]);
        rig.command(PWM, 1800.0);
        for _ in 0..11 {
            rig.run(100);
            rig.text(text);
        }
        assert_eq!(rig.program.node.pulse(0), 0, "{text}");
    }
    let mut rig = Rig::with(&[(OutputParameter::Fs.of(0), 3)]);
    for _ in 0..100 {
        rig.command(PWM, 1800.0);
        rig.run(999);
        assert_eq!(rig.program.node.pulse(0), us(1800.0));
    }
}

#[cfg(feature = "standard")]
const ARMED: &str = "18044C0A FF C0";

#[cfg(feature = "standard")]
#[test]
fn where_arming_is_required_only_an_armed_vehicle_is_followed() {
    let mut rig = Rig::with(&[(Parameter::ArmReq, 1)]);
    rig.run(1);
    assert_eq!(rig.code(), 1 << 14);
    rig.command(PWM, 1800.0);
    rig.text("1804570A 80 C0");
    assert_eq!((rig.program.node.pulse(0), rig.program.node.health().counts.refused), (0, 2));
    rig.text(ARMED);
    rig.run(1);
    rig.command(PWM, 1800.0);
    assert_eq!((rig.program.node.pulse(0), rig.code()), (us(1800.0), 0));
}

#[cfg(feature = "standard")]
#[test]
fn anything_but_255_disarms_and_brings_the_servo_to_its_failsafe() {
    for (failsafe, expected) in [(0, 1800.0), (1, 1500.0), (2, 1200.0), (3, 0.0)] {
        for status in [0, 1, 128, 254] {
            let mut rig = Rig::with(&[
                (Parameter::ArmReq, 1),
                (OutputParameter::Fs.of(0), failsafe),
                (OutputParameter::FsPwm.of(0), 1200),
            ]);
            rig.text(ARMED);
            rig.run(1);
            rig.command(PWM, 1800.0);
            rig.text(&format!("18044C0A {status:02X} C0"));
            rig.run(1);
            assert_eq!(
                (rig.program.node.pulse(0), rig.code()),
                (us(expected), 1 << 14),
                "{failsafe} {status}"
            );
            rig.command(PWM, 1900.0);
            rig.run(2000);
            assert_eq!(rig.program.node.pulse(0), us(expected));
            assert_eq!(rig.code(), 1 << 14, "no failsafe: it is not that commands were missing");
        }
    }
}

#[cfg(feature = "standard")]
#[test]
fn arming_ends_four_to_five_seconds_after_the_last_arming_status() {
    for start in [59_000, 59_001, 59_250, 59_500, 59_999] {
        let mut rig = Rig::with(&[
            (Parameter::ArmReq, 1),
            (OutputParameter::Timeout.of(0), 0),
            (OutputParameter::Fs.of(0), 3),
        ]);
        rig.run(start);
        for _ in 0..20 {
            rig.text(ARMED);
            rig.run(500);
            rig.command(PWM, 1800.0);
        }
        assert_eq!(rig.program.node.pulse(0), us(1800.0));
        rig.run(3500);
        assert_eq!((rig.program.node.pulse(0), rig.code()), (us(1800.0), 0), "{start}");
        rig.run(1001);
        assert_eq!((rig.program.node.pulse(0), rig.code()), (0, 1 << 14), "{start}");
    }
}

#[test]
fn where_arming_is_not_required_it_does_not_matter() {
    let mut rig = Rig::new();
    rig.text("18044C0A 00 C0");
    rig.run(1);
    rig.command(PWM, 1800.0);
    assert_eq!((rig.program.node.pulse(0), rig.code()), (us(1800.0), 0));
}

#[cfg(feature = "standard")]
#[test]
fn the_first_command_after_a_start_needs_arming_too() {
    let mut rig = Rig::with(&[(Parameter::ArmReq, 1)]);
    // Before the end of the first millisecond.
    rig.command(PWM, 1800.0);
    assert_eq!(rig.program.node.pulse(0), 0);
}

// Messages

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

#[cfg(feature = "standard")]
#[test]
fn by_default_it_sends_ten_actuator_statuses_and_a_temperature_a_second() {
    let mut rig = Rig::new();
    rig.run(10_000);
    assert_eq!(rig.transfers(ACTUATOR_STATUS, golden::ACTUATOR_STATUS).len(), 100);
    assert_eq!(rig.transfers(TEMPERATURE, 0).len(), 10);
    #[cfg(feature = "stats")]
    assert_eq!(rig.transfers(CAN_STATS, golden::CAN_STATS).len(), 0);
    assert_eq!(rig.can.sent.len(), 10 + 2 * 100 + 10);
}

#[test]
fn the_golden_temperature_is_sent() {
    let mut rig = Rig::new();
    rig.run(3500);
    // The third temperature has transfer ID 2.
    assert_eq!(golden::text(rig.sent(TEMPERATURE).last()), "18045678 01 00 A9 5C 00 C2");
}

#[test]
fn the_temperature_has_its_device_id() {
    let mut rig = Rig::with(&[(Parameter::TempId, 0xBEEF)]);
    rig.run(1500);
    assert_eq!(rig.transfers(TEMPERATURE, 0)[0].1[..2], [0xEF, 0xBE]);
}

#[test]
fn no_temperature_is_sent_before_there_is_one() {
    let mut rig = Rig::with(&[(Parameter::TempRate, 50)]);
    rig.run(200);
    assert!(rig.transfers(TEMPERATURE, 0)[0].0 >= 63);
}

#[cfg(feature = "standard")]
#[test]
fn the_actuator_status_has_the_position_that_was_commanded_and_nothing_that_is_not_known() {
    let mut rig = Rig::with(&[(OutputParameter::Id.of(0), 1), (OutputParameter::Timeout.of(0), 0)]);
    rig.run(150);
    let nan = [0x00, 0x7E];
    let payload = |position: [u8; 2]| [&[1], &position[..], &nan, &nan, &[127]].concat();
    let last = |rig: &Rig| rig.transfers(ACTUATOR_STATUS, golden::ACTUATOR_STATUS).pop().unwrap().1;
    assert_eq!(last(&rig), payload(nan), "no pulse");
    for (unitless, radians) in
        [(0.0, 0.0), (1.0, FRAC_PI_4), (-1.0, -FRAC_PI_4), (0.5, std::f64::consts::FRAC_PI_8)]
    {
        rig.command(UNITLESS, unitless);
        rig.run(100);
        let bytes = last(&rig);
        let position = half::f16::from_le_bytes([bytes[1], bytes[2]]).to_f64();
        assert!((position - radians).abs() < 0.0005, "{position} is not {radians}");
        assert_eq!(bytes, payload([bytes[1], bytes[2]]));
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

#[cfg(feature = "button")]
#[test]
fn each_press_of_the_button_sends_its_count() {
    let mut rig = Rig::new();
    for _ in 0..2 {
        rig.is_pressed = true;
        rig.run(50);
        rig.is_pressed = false;
        rig.run(50);
    }
    assert_eq!(
        golden::text(&rig.sent(KEY_VALUE)),
        golden::text(
            &[
                golden::frames("183FF278 00 00 80 3F 62 74 6E C0"),
                golden::frames("183FF278 00 00 00 40 62 74 6E C1")
            ]
            .concat()
        )
    );
}

#[cfg(all(feature = "button", not(feature = "draft")))]
#[test]
fn a_pressed_button_is_sent_ten_times_a_second_with_its_time() {
    let mut rig = Rig::new();
    rig.is_pressed = true;
    rig.run(350);
    rig.is_pressed = false;
    rig.run(500);
    assert_eq!(golden::text(&rig.sent(0x184E_2178)), "184E2178 01 01 C0 | 01 02 C1 | 01 03 C2");
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

// Filters

#[test]
fn filters_are_set_once_at_a_failsafe_with_no_command_heard() {
    let mut rig = Rig::new();
    rig.command(PWM, 1800.0);
    rig.run(20_000);
    assert_eq!((rig.can.filters_set, rig.code()), (1, 1 << 10));
    rig.command(PWM, 1800.0);
    rig.run(20_000);
    assert_eq!(rig.can.filters_set, 2, "and at the next");
}

#[test]
fn filters_stay_as_they_are_while_commands_are_heard_that_cannot_be_followed_or_nothing_happens() {
    let mut rig = Rig::new();
    rig.run(5000);
    assert_eq!(rig.can.filters_set, 0);
    rig.command(PWM, 1800.0);
    for _ in 0..50 {
        rig.run(100);
        // A command for another actuator.
        rig.text("1003F20A 02 00 00 38 C7");
    }
    assert_eq!((rig.can.filters_set, rig.code()), (0, 1 << 10));
}

#[test]
fn filters_wait_until_no_transfer_goes_out_for_four_seconds_at_most_and_for_none_that_comes_in() {
    let start = || {
        let mut rig = Rig::with(&rates(0, 0, 0));
        rig.run(1500);
        rig.command(PWM, 1800.0);
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

// Random input

#[cfg(feature = "standard")]
#[test]
fn no_traffic_and_no_settings_make_it_panic_or_move_the_servo_out_of_its_range() {
    let mut random = 12_345u32;
    let mut next = move || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 16) as u16
    };
    let mut rig = Rig::with(&rates(50, 50, 10));
    let (mut asked, mut set) = (0, 0);
    for n in 0..60_000u32 {
        let source = u32::from(next() % 3 + 9);
        let transfer_id = (next() & 31) as u8;
        let random_bytes: [u8; 7] = std::array::from_fn(|_| next() as u8);
        match next() % 8 {
            0 | 1 => {
                let entries: Vec<u8> = (0..4 * (next() % 4))
                    .map(|n| if n % 4 < 2 { next() as u8 & 5 } else { next() as u8 })
                    .collect();
                rig.frames(&golden::transfer(
                    0x1003_F200 | source,
                    golden::ARRAY_COMMAND,
                    transfer_id,
                    &entries,
                ));
            }
            2 => {
                // Set a parameter to a random value, a small value, or a limit of some parameter.
                let index = (next() % crate::tables::parameters::COUNT as u16) as u8;
                let value = match next() % 3 {
                    0 => i64::from(next()),
                    1 => i64::from(next() % 1000) - 500,
                    _ => [0, 1, 10, 50, 125, 360, 500, 1000, 1500, 2500, 10_000, 65_535, 125_000]
                        [usize::from(next() % 13)],
                };
                if index == Parameter::CanNode.index() && n % 2 == 0 {
                    continue;
                }
                let payload = [&[index, 1][..], &value.to_le_bytes()].concat();
                let before = rig.program.node.parameters;
                rig.frames(&golden::transfer(
                    0x1E0B_F880 | source,
                    golden::GET_SET,
                    transfer_id,
                    &payload,
                ));
                asked += 1;
                set += u32::from(rig.program.node.parameters != before);
            }
            3 => {
                let service = [1, 4, 5, 10, 11, 40][usize::from(next() % 6)];
                let id = 0x1E00_F880 | service << 16 | source;
                rig.frames(&[golden::frame(
                    id,
                    &[&random_bytes[..usize::from(next() % 8)], &[0xC0 | transfer_id]].concat(),
                )]);
            }
            4 => rig.frames(&[golden::frame(
                0x1001_5500 | source,
                &[&random_bytes[..], &[0xC0 | transfer_id]].concat(),
            )]),
            5 => {
                let id = [0x1804_3900, 0x1804_4C00, 0x1804_5700, 0x1E00_0100]
                    [usize::from(next() % 4)]
                    | source;
                rig.frames(&[golden::frame(
                    id,
                    &[&random_bytes[..usize::from(next() % 8)], &[0xC0 | transfer_id]].concat(),
                )]);
            }
            6 => {
                let data: Vec<u8> = (0..next() % 9).map(|_| next() as u8).collect();
                let ids = [0x1003_F200, 0x1804_3900, 0x1E0B_F880, 0x1E28_F880, 0x1E00_0100];
                rig.frames(&[golden::frame(ids[usize::from(next() % 5)] | source, &data)]);
            }
            _ => {
                rig.readings = [next() % 1024, next() % 1024];
                rig.is_pressed = next() & 1 == 0;
                rig.can.room = if next() & 7 == 0 { 0 } else { u32::MAX };
            }
        }
        rig.run(u32::from(next() % 4));
        let pulse = rig.program.node.pulse(0);
        assert!(pulse == 0 || (us(500.0)..=us(2500.0)).contains(&pulse), "{pulse}");
    }
    // Most values are out of the range of their parameter, or do not go together with others: the
    // fewest are set with `escs` alone, one in eight.
    assert!(set > asked / 10, "{set} of {asked}");
    assert!(
        rig.program.node.health().counts.followed > 50,
        "{:?}",
        rig.program.node.health().counts
    );
}
