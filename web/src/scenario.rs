//! The traffic of the cross-check, and its trace.
//!
//! A scenario is a list of actions in simulated time that follow from a seed. Its trace has a line
//! for each frame, pulse and serial line, and the EEPROM at the end. Two processors that agree to
//! the cycle give equal traces.

use std::cell::RefCell;
use std::fmt::Write;
use std::rc::Rc;

use anyhow::Result;
use bench::autopilot::{Moves, Profile, Settings};
use bench::avr::{Avr, Firmware, ResetCause};
use bench::can::{Fault, Frame, Level, RecordKind};
use bench::dronecan::{Dialect, Message, Opcode, ParameterRequest, Value};
use bench::wiring::Wiring;
use bench::{Cycles, F_CPU_HZ, Noise};

use crate::world::{Happened, World};

/// Simulated time of one round of actions. Further rounds differ in their random values.
const ROUND_MS: u64 = 10_000;
/// Random frames per round of the further station, and in its burst.
const FRAMES: u64 = 200;
const BURST: u64 = 60;

/// Who commands the node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Traffic {
    Ardupilot,
    Px4,
    /// The draft of 2014, for programs with the preset `thesis`.
    Thesis,
}

impl Traffic {
    /// The traffic with a name: `ardupilot`, `px4` or `thesis`.
    pub fn named(name: &str) -> Option<Traffic> {
        match name {
            "ardupilot" => Some(Traffic::Ardupilot),
            "px4" => Some(Traffic::Px4),
            "thesis" => Some(Traffic::Thesis),
            _ => None,
        }
    }

    fn settings(self) -> Settings {
        match self {
            Traffic::Ardupilot => {
                Settings { moves: Moves::All, ..Settings::of(Profile::Ardupilot) }
            }
            Traffic::Px4 => Settings::of(Profile::Px4),
            Traffic::Thesis => Settings::of(Profile::Thesis).in_dialect(Dialect::Draft),
        }
    }
}

/// An action on the world.
enum Action {
    Temperature(f64),
    Button(bool),
    Serial(&'static [u8]),
    Request(Message),
    Set(&'static str, i64),
    Frame(Frame),
    ErrorRate(u32),
    Reset(ResetCause),
}

/// Runs a program for `seconds` of simulated time, and returns the trace.
///
/// # Errors
/// If the wiring in the program is impossible.
pub fn run(
    avr: Avr,
    firmware: &Firmware,
    traffic: Traffic,
    seconds: u64,
    seed: u64,
) -> Result<String> {
    let wiring = Wiring::of_program(firmware)?;
    let mut world = World::new(avr, &wiring, wiring.fastest_bit_rate(), traffic.settings())?;
    let wire: Rc<RefCell<Vec<(Cycles, Level)>>> = Rc::default();
    let tap = Rc::clone(&wire);
    world
        .bench
        .bus()
        .set_wire_tap(Some(Box::new(move |at, level| tap.borrow_mut().push((at, level)))));
    let mut trace = String::new();
    let end = seconds * F_CPU_HZ;
    let mut noise = Noise::new(seed);
    let mut actions = Vec::new();
    for round in 0..(seconds * 1000).div_ceil(ROUND_MS) {
        actions.extend(round_of_actions(round * ROUND_MS, &mut noise));
    }
    actions.sort_by_key(|(ms, _)| *ms);
    for (ms, action) in actions {
        let at = (ms * F_CPU_HZ / 1000).min(end);
        while world.now() < at {
            // Short steps keep the memory of the wire's levels small.
            let next = at.min(world.now() + F_CPU_HZ / 10);
            world.advance(next);
            let happened = world.take();
            write_lines(&mut trace, &happened, &mut wire.borrow_mut());
        }
        apply(&mut world, action);
    }
    world.advance(end);
    let happened = world.take();
    write_lines(&mut trace, &happened, &mut wire.borrow_mut());
    let eeprom = world.board().avr().eeprom();
    for (row, bytes) in eeprom.chunks(16).enumerate() {
        let _ = writeln!(trace, "eeprom {:04x} {bytes:02x?}", row * 16);
    }
    Ok(trace)
}

fn round_of_actions(start: u64, noise: &mut Noise) -> Vec<(u64, Action)> {
    let mut actions = Vec::new();
    for step in 0..20 {
        let celsius = noise.below(800) as f64 / 10.0;
        actions.push((start + 500 * step + 13, Action::Temperature(celsius)));
    }
    for step in 0..40 {
        let index = noise.below(45) as u16;
        let request = ParameterRequest { index, ..ParameterRequest::default() };
        actions
            .push((start + 2000 + 150 * step, Action::Request(Message::ParameterRequest(request))));
    }
    for _ in 0..FRAMES {
        actions.push((start + noise.below(ROUND_MS), Action::Frame(random_frame(noise))));
    }
    let burst = start + 3000 + noise.below(3000);
    actions.extend((0..BURST).map(|_| (burst, Action::Frame(random_frame(noise)))));
    let trim = 1400 + noise.below(200) as i64;
    actions.extend([
        (start + 1800, Action::Request(Message::NodeInfoRequest)),
        (start + 2500, Action::Serial(b"?")),
        (start + 3000, Action::Set("OUT1_TRIM", trim)),
        (start + 3010, Action::Set("TEMP_RATE", 1 + noise.below(40) as i64)),
        (start + 3300, Action::Request(Message::ExecuteOpcode(Opcode::SAVE))),
        (start + 4100, Action::Button(true)),
        (start + 4300, Action::Button(false)),
        (start + 4600, Action::ErrorRate(300)),
        (start + 5200, Action::ErrorRate(0)),
        (start + 6100, Action::Request(Message::RestartNode(bench::dronecan::RESTART_MAGIC))),
        (start + 8200, Action::Reset(ResetCause::External)),
    ]);
    actions
}

/// A frame with a random identifier of either length, and random data.
fn random_frame(noise: &mut Noise) -> Frame {
    let bytes = noise.next_u64().to_le_bytes();
    let data = &bytes[..noise.below(9) as usize];
    let random = noise.next_u64() as u32;
    match noise.below(8) {
        0 => Frame::standard((random & 0x7FF) as u16, data),
        _ => Frame::extended(random & 0x1FFF_FFFF, data),
    }
}

fn apply(world: &mut World, action: Action) {
    match action {
        Action::Temperature(celsius) => world.set_temperature_c(celsius),
        Action::Button(pressed) => world.board().press_button(pressed),
        Action::Serial(bytes) => world.board().avr_mut().serial_send(bytes),
        Action::Request(message) => world.client.dialogue.request(message),
        Action::Set(name, value) => world.client.dialogue.set(name, Value::Integer(value)),
        Action::Frame(frame) => world.other().borrow_mut().send(frame),
        Action::ErrorRate(per_million) => {
            world.bench.bus().inject(Fault::BitErrorRate { per_million, seed: 1 });
        }
        Action::Reset(cause) => world.board().reset(cause),
    }
}

/// Writes the lines of what happened. A frame has the levels of the wire as a hash of its edges.
fn write_lines(trace: &mut String, happened: &Happened, wire: &mut Vec<(Cycles, Level)>) {
    for (record, from) in &happened.records {
        let mut edges = 0;
        let mut hash = 0xCBF2_9CE4_8422_2325_u64;
        for (at, level) in wire.iter().filter(|(at, _)| (record.start..record.end).contains(at)) {
            edges += 1;
            for byte in (*at << 1 | *level as u64).to_le_bytes() {
                // FNV-1a.
                hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3);
            }
        }
        let from = from.as_deref().unwrap_or("-");
        let kind = match &record.kind {
            RecordKind::Frame { frame, acked, .. } => format!("{frame} acked {acked}"),
            RecordKind::ErrorFrame { kind, .. } => format!("error {kind:?}"),
        };
        let (start, bits) = (record.start, record.bits);
        let _ =
            writeln!(trace, "frame {start} {bits} bits {edges} edges {hash:016x} {from}: {kind}");
    }
    let last = happened.records.last().map_or(0, |(record, _)| record.end);
    wire.retain(|(at, _)| *at >= last);
    for (output, pulse) in &happened.pulses {
        let _ = writeln!(trace, "pulse {} {} {}", output + 1, pulse.start, pulse.width_cycles);
    }
    for (at, line) in &happened.lines {
        let _ = writeln!(trace, "serial {at} {line}");
    }
}
