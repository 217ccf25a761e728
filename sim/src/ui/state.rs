//! The state of the bench as the views show it, updated as simulated time passes.
//!
//! Plain data and the rules that update it: no bench, no terminal, no wall clock. The scene updates
//! it, the live view draws it, and the plain view prints its events. Histories are bounded;
//! counters are not.

use super::escs::{Escs, Throttle};
use super::history::Log;
use super::measured::Measured;
use super::mistakes::Mistakes;
use super::traffic::{ERROR_FRAME, Origin, Traffic, TrafficLine};
use crate::fault::Fault;
use crate::time::micros;
use crate::utilisation::measured::LoadByType;
use bench::board::{PULSE_TIMEOUT, SpiUse};
use bench::budget::Budget;
use bench::can::{ErrorState, Frame, Id, Record, RecordKind};
use bench::dronecan::{
    CanId, DataType, Decoded, Dialect, Message, NodeId, NodeStatus, Observation, Observer, draft,
    text::visible,
};
use bench::serial_line::SerialLine;
use bench::vendor_code;
use bench::wiring::Wiring;
use bench::{Cycles, F_CPU_HZ};
use std::cell::RefCell;
use std::collections::VecDeque;

/// Bus load and frame rate are measured over this time.
const RATE_WINDOW: Cycles = F_CPU_HZ;
/// OFFLINE_TIMEOUT_MS of NodeStatus, in v0 and in the draft.
const OFFLINE_AFTER: Cycles = 3 * F_CPU_HZ;
/// Intermission between two frames (ISO 11898-1): part of the load, because no frame can use it.
const INTERMISSION_BITS: u32 = 3;

/// The report lists this many lost frames, resets and hints, the first ones. Counters count them
/// all.
const LOST_FRAMES_MAX: usize = 100;
const RESETS_MAX: usize = 100;
const HINTS_MAX: usize = 20;

/// An event that the plain view prints as a line.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    Serial(String),
    Traffic(TrafficLine),
    /// A NodeStatus in words.
    Status(NodeId, String),
    ErrorFrame(String),
    /// A driver mistake that the models noticed, the first of its kind.
    Mistake(String),
    /// A probable error in the program or in its settings, for its author.
    Hint(String),
    /// A frame that passed the filters and was lost, and why.
    Lost(String),
    /// The node's program cannot go on.
    Crash(String),
    /// The controller's error state changed.
    Controller(String),
    /// The user began or ended a fault.
    Fault(String),
    /// The board that the node runs on.
    Board(String),
    /// The AVR was reset.
    Reset(String),
    /// State of a program that is joined to the bench.
    Link(String),
    /// The autopilot received a node's information, or allocated its node ID.
    Node(String),
    /// The light's new brightness, in per cent.
    Light(u32),
    /// A watched pin has changed, or a pin was set.
    Pin(String),
    /// A transaction on the two-wire bus.
    I2c(String),
}

/// Pulses on the servo output.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Servo {
    /// Width of the last pulse; `None` while the output is off.
    pub pulse: Option<Cycles>,
    /// Time between the starts of the last two pulses.
    pub period: Option<Cycles>,
    pub last_start: Cycles,
    pub count: u64,
    /// Widths of the shortest and the longest pulse so far.
    pub shortest: Option<Cycles>,
    pub longest: Option<Cycles>,
}

impl Servo {
    /// The width and the period of the pulses in words, if there are any.
    pub fn words(&self) -> Vec<String> {
        let width = self.pulse.map(|width| format!("pulse {:.1} us", micros(width)));
        let period = self.period.filter(|_| width.is_some());
        let period = period.map(|period| format!("period {:.3} ms", micros(period) / 1e3));
        width.into_iter().chain(period).collect()
    }
}

/// Counters of the bus.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BusState {
    pub bit_rate: u32,
    pub frames: u64,
    pub error_frames: u64,
    /// Frames without an acknowledgement.
    pub unacknowledged: u64,
    /// End, length in bits, and true for a valid frame, of all frames and error frames within
    /// `RATE_WINDOW`.
    window: VecDeque<(Cycles, u32, bool)>,
}

impl BusState {
    /// Busy share of the last second, in per cent.
    pub fn load_percent(&self, now: Cycles) -> f64 {
        let bits: u64 = self.window.iter().map(|w| u64::from(w.1)).sum();
        let span = now.clamp(1, RATE_WINDOW) as f64 / F_CPU_HZ as f64;
        (bits as f64 * 100.0 / (f64::from(self.bit_rate.max(1)) * span)).min(100.0)
    }

    /// Valid frames in the last second.
    pub fn frames_per_second(&self) -> usize {
        self.window.iter().filter(|w| w.2).count()
    }

    fn drop_old(&mut self, now: Cycles) {
        let oldest = now.saturating_sub(RATE_WINDOW);
        while self.window.front().is_some_and(|w| w.0 <= oldest) {
            self.window.pop_front();
        }
    }
}

/// The node's MCP2515.
#[derive(Clone, Debug, PartialEq)]
pub struct Controller {
    /// Operating mode, as the datasheet calls it.
    pub mode: String,
    pub tec: u16,
    pub rec: u16,
    pub error_state: ErrorState,
    /// Frames that the controller lost because both receive buffers were full.
    pub overflows: u64,
}

impl Default for Controller {
    fn default() -> Controller {
        Controller {
            mode: String::from("?"),
            tec: 0,
            rec: 0,
            error_state: ErrorState::Active,
            overflows: 0,
        }
    }
}

/// Time that received frames waited in the chip, from the end of the frame until the driver cleared
/// RXnIF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Latency {
    pub last: Option<Cycles>,
    pub worst: Option<Cycles>,
}

/// Memory that the firmware uses, in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// .text + .data.
    pub flash: u32,
    /// .data + .bss; `None` for a chip with a bootloader, because an update can have replaced the
    /// program.
    pub statics: Option<u32>,
    /// Deepest stack so far; `None` for a program with several.
    pub stack: Option<u32>,
    /// Limits of this project; `None` for a program without the ELF section `.board`.
    pub limits: Option<Budget>,
}

impl Memory {
    /// One of the limits; `None` for a program without limits.
    pub fn limit(&self, of: fn(Budget) -> u32) -> Option<u32> {
        self.limits.map(of)
    }
}

/// State of the autopilot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AutopilotState {
    pub node_id: u8,
    /// Commanded deflection, -1 to 1.
    pub deflection: f64,
    /// True if the autopilot moves all its actuators, not one.
    pub moves_all: bool,
    pub motors: u8,
    pub is_sweeping: bool,
    pub is_silent: bool,
    pub is_armed: bool,
    pub dialect: Dialect,
    /// Flight controller that the autopilot imitates.
    pub profile: String,
    pub command_type: String,
    pub commands_sent: u64,
}

/// The state of the bench. Public fields are for the views to read.
#[derive(Default)]
pub struct State {
    pub now: Cycles,
    /// The board of the node under test.
    pub wiring: Wiring,
    pub servo: Servo,
    /// The outputs with an ESC.
    pub escs: Escs,
    /// Start and width of the last pulse of output 2 and each further output; empty if the board
    /// has one output.
    pub outputs: Vec<Option<(Cycles, Cycles)>>,
    /// Brightness of the light, in per cent.
    pub light_percent: u32,
    /// The watched pins and their levels.
    pub pins: Vec<String>,
    /// Temperature at the sensor, in degrees Celsius.
    pub sensor_c: f64,
    /// Millivolts at the inputs for the voltage and the current of the circuit.
    pub circuit_inputs_mv: [u32; 2],
    /// Revolutions a minute of the shaft at the node's input.
    pub shaft_rpm: u32,
    /// The measurements in the node's last messages.
    pub measured: Measured,
    /// Last NodeStatus of the node under test, and its time. A status of the draft is converted to
    /// v0.
    pub status: Option<(Cycles, NodeId, NodeStatus)>,
    /// Dialect of the last NodeStatus.
    pub dialect: Dialect,
    /// True for a program of this project: the views show its vendor-specific status code in
    /// words.
    pub knows_vendor_code: bool,
    pub bus: BusState,
    /// Load by node and type. Drawing it drops old frames, hence the cell.
    pub load_by_type: RefCell<LoadByType>,
    pub controller: Controller,
    pub latency: Latency,
    pub traffic: Traffic,
    pub serial: Log<(Cycles, String)>,
    pub mistakes: Mistakes,
    /// Probable errors in the program or in its settings, each once, the first `HINTS_MAX`.
    pub hints: Vec<String>,
    /// What the program used of the processor that is not modelled exactly, each once.
    pub unmodelled: Vec<String>,
    /// What the program has written to devices on the two-wire bus: address, first register,
    /// values.
    pub i2c: Vec<(u8, u8, Vec<u8>)>,
    /// Frames that the node lost, the first `LOST_FRAMES_MAX`.
    pub lost_frames: Vec<(Cycles, Frame)>,
    /// Frames that passed the node's filters, including lost ones.
    pub frames_for_node: u64,
    /// Frames that the node sent.
    pub frames_of_node: u64,
    pub spi: SpiUse,
    /// Time and cause of resets since power-on, the first `RESETS_MAX`.
    pub resets: Vec<(Cycles, String)>,
    pub resets_total: u64,
    pub crash: Option<String>,
    pub memory: Memory,
    /// `None` on a bench without autopilot.
    pub autopilot: Option<AutopilotState>,
    /// State of each link, further boards included, a line each.
    pub links: Vec<String>,
    /// Lasting faults that are on.
    pub active_faults: Vec<Fault>,
    serial_line: SerialLine,
    observer: Observer,
    /// The nodes that have sent a whole transfer of a known type, as bits: they speak DroneCAN.
    speakers: u128,
    events: Vec<(Cycles, Event)>,
}

impl State {
    /// State at time 0 on a bus of `bit_rate` bits per second.
    pub fn new(bit_rate: u32) -> State {
        let mut state = State::default();
        state.bus.bit_rate = bit_rate;
        state.load_by_type = RefCell::new(LoadByType::new(bit_rate));
        state
    }

    /// Removes and returns the events since the last call, in order of time.
    pub fn take_events(&mut self) -> Vec<(Cycles, Event)> {
        self.events.sort_by_key(|(at, _)| *at);
        std::mem::take(&mut self.events)
    }

    /// Queues an event for [`State::take_events`].
    pub fn report(&mut self, at: Cycles, event: Event) {
        self.events.push((at, event));
    }

    /// Sets simulated time to `now`, and drops what has timed out by then.
    pub fn advance_to(&mut self, now: Cycles) {
        self.now = now;
        self.bus.drop_old(now);
        if now.saturating_sub(self.servo.last_start) > PULSE_TIMEOUT {
            self.servo.pulse = None;
            self.servo.period = None;
        }
        for output in &mut self.outputs {
            *output = output.filter(|(start, _)| now.saturating_sub(*start) <= PULSE_TIMEOUT);
        }
    }

    /// Takes the last whole pulse, start and width, of output 2 and each further output. `None`: no
    /// new pulse.
    pub fn set_output_pulses(&mut self, last: impl IntoIterator<Item = Option<(Cycles, Cycles)>>) {
        let last: Vec<_> = last.into_iter().collect();
        self.outputs.resize(last.len(), None);
        for (output, pulse) in self.outputs.iter_mut().zip(last) {
            *output = pulse.or(*output);
        }
    }

    /// Pulse widths from output 2 to the last output that gives pulses; `None` for an output
    /// between that gives none.
    pub fn output_widths(&self) -> Vec<Option<Cycles>> {
        let count = self.outputs.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
        self.outputs[..count].iter().map(|output| output.map(|(_, width)| width)).collect()
    }

    /// The throttle of output 1; `None` if it has a servo or no pulse.
    pub fn throttle(&self) -> Option<Throttle> {
        self.servo.pulse.and_then(|width| self.escs.throttle(1, width, self.servo.period))
    }

    /// True if output 1 has a motor.
    pub fn is_motor(&self) -> bool {
        self.throttle().is_some() || self.escs.has(1)
    }

    /// What output 1 moves, in a word.
    pub fn moved(&self) -> &'static str {
        if self.is_motor() { "motor" } else { "servo" }
    }

    /// The throttle of an output with this pulse; `None` if it has a servo. All outputs have the
    /// same period.
    pub fn throttle_of(&self, output: usize, width: Cycles) -> Option<Throttle> {
        self.escs.throttle(output as u8, width, self.servo.period)
    }

    /// Adds a whole servo pulse.
    pub fn add_pulse(&mut self, start: Cycles, width: Cycles, period: Option<Cycles>) {
        let servo = &mut self.servo;
        servo.period = period.filter(|period| *period < PULSE_TIMEOUT);
        servo.pulse = Some(width);
        servo.last_start = start;
        servo.count += 1;
        servo.shortest = Some(servo.shortest.map_or(width, |shortest| shortest.min(width)));
        servo.longest = servo.longest.max(Some(width));
    }

    /// Sets the brightness of the light, 0 to 1. Reports a change of the whole per cents.
    pub fn set_light(&mut self, at: Cycles, brightness: f64) {
        let percent = (brightness * 100.0).round() as u32;
        if percent != self.light_percent {
            self.light_percent = percent;
            self.report(at, Event::Light(percent));
        }
    }

    /// Adds a byte from the node's serial port.
    pub fn push_serial_byte(&mut self, at: Cycles, byte: u8) {
        if let Some((at, line)) = self.serial_line.push(at, byte) {
            self.report(at, Event::Serial(line.clone()));
            self.serial.push((at, line));
        }
    }

    /// Counts a driver mistake. Reports the first of its kind. The text can have names from the
    /// program; so can that of a hint and of a crash.
    pub fn add_mistake(&mut self, at: Cycles, text: String) {
        let text = visible(&text).into_owned();
        if self.mistakes.add(at, &text) {
            self.report(at, Event::Mistake(text));
        }
    }

    /// Reports a hint, unless its text was reported before or `HINTS_MAX` texts were.
    pub fn add_hint(&mut self, at: Cycles, text: String) {
        let text = visible(&text).into_owned();
        if self.hints.len() < HINTS_MAX && !self.hints.contains(&text) {
            self.hints.push(text.clone());
            self.report(at, Event::Hint(text));
        }
    }

    /// True if the node should have sent or fetched a frame, and has not. A sketch that uses
    /// neither the SPI nor CS has no CAN; a program of this project always has.
    pub fn has_never_sent(&self) -> bool {
        let SpiUse { selects, bytes, bytes_elsewhere } = self.spi;
        let has_can = self.knows_vendor_code || selects + bytes + bytes_elsewhere > 0;
        has_can && self.frames_of_node == 0 && self.latency.worst.is_none()
    }

    /// Lowest stack pointer so far, if the depth of the stack is known.
    pub fn lowest_sp(&self) -> Option<u32> {
        Some(u32::from(self.wiring.chip.ram_end()).saturating_sub(self.memory.stack?))
    }

    /// `count` divided by the number of frames that the node received and sent; `None` if there
    /// were no frames.
    pub fn per_node_frame(&self, count: u64) -> Option<f64> {
        let frames = self.frames_for_node + self.frames_of_node;
        (frames > 0).then(|| count as f64 / frames as f64)
    }

    /// Adds and reports a frame that the node lost.
    pub fn add_lost_frame(&mut self, at: Cycles, frame: Frame, why: &str) {
        if self.lost_frames.len() < LOST_FRAMES_MAX {
            self.lost_frames.push((at, frame));
        }
        self.report(at, Event::Lost(format!("frame lost, {why}: {frame}")));
    }

    /// Counts and reports a reset of the AVR.
    pub fn add_reset(&mut self, at: Cycles, cause: String) {
        self.resets_total += 1;
        if self.resets.len() < RESETS_MAX {
            self.resets.push((at, cause.clone()));
        }
        self.report(at, Event::Reset(format!("the AVR was reset: {cause}")));
    }

    /// Adds a feature of the processor that the program uses and that is not modelled exactly.
    /// Reports each once.
    pub fn add_unmodelled(&mut self, at: Cycles, text: &str) {
        if !self.unmodelled.iter().any(|known| known == text) {
            self.unmodelled.push(text.to_owned());
            let hint = format!("not modelled exactly: {text} (docs/peripherals.md)");
            self.report(at, Event::Hint(hint));
        }
    }

    /// Adds a start of the program that no reset caused.
    pub fn add_jump(&mut self, at: Cycles, why: &str) {
        self.resets_total += 1;
        if self.resets.len() < RESETS_MAX {
            self.resets.push((at, String::from("Jump")));
        }
        let text = format!(
            "the program jumped to its start without a reset{why}: its registers keep their values"
        );
        self.report(at, Event::Reset(text));
    }

    /// The hints and the features that are not modelled exactly, in the words of the screen.
    pub fn notices(&self) -> impl Iterator<Item = String> {
        let unmodelled = self.unmodelled.iter().map(|text| format!("not modelled exactly: {text}"));
        self.hints.iter().cloned().chain(unmodelled)
    }

    /// Time since the node's last NodeStatus, if it is longer than 3 s. Both dialects define such a
    /// node as offline.
    pub fn silent_for(&self) -> Option<Cycles> {
        let (at, _, _) = self.status?;
        Some(self.now.saturating_sub(at)).filter(|age| *age > OFFLINE_AFTER)
    }

    /// Reports that the node's program crashed. Later calls change nothing.
    pub fn set_crash(&mut self, at: Cycles, text: String) {
        if self.crash.is_none() {
            let text = visible(&text).into_owned();
            self.report(at, Event::Crash(text.clone()));
            self.crash = Some(text);
        }
    }

    /// Sets the state of the controller. Reports a change of its error state.
    pub fn set_controller(&mut self, controller: Controller) {
        if controller.error_state != self.controller.error_state {
            let text = format!(
                "{} (TEC {}, REC {})",
                error_state_name(&controller.error_state),
                controller.tec,
                controller.rec
            );
            self.report(self.now, Event::Controller(text));
        }
        self.controller = controller;
    }

    /// Adds the time that the driver left a received frame in the chip.
    pub fn add_latency(&mut self, latency: Cycles) {
        self.latency.last = Some(latency);
        self.latency.worst = self.latency.worst.max(Some(latency));
    }

    /// Adds a frame or an error frame of the bus. `from_node` is true if the node under test sent
    /// it; `station` is the sender's name.
    pub fn add_record(&mut self, record: &Record, from_node: bool, station: Option<&str>) {
        self.load_by_type.get_mut().record(record);
        let valid = matches!(record.kind, RecordKind::Frame { .. });
        self.bus.window.push_back((record.end, record.bits + INTERMISSION_BITS, valid));
        match &record.kind {
            RecordKind::Frame { frame, acked, .. } => {
                self.bus.frames += 1;
                if !acked {
                    self.bus.unacknowledged += 1;
                }
                self.frames_of_node += u64::from(from_node);
                self.add_frame(record.end, frame, from_node, station);
            }
            RecordKind::ErrorFrame { kind, .. } => {
                self.bus.error_frames += 1;
                let mut text = String::from("error frame");
                if let Some(kind) = kind {
                    text += &format!(": {} error", format!("{kind:?}").to_lowercase());
                }
                if let Some(station) = station {
                    text += &format!(", {station} was sending");
                }
                self.report(record.end, Event::ErrorFrame(text.clone()));
                self.add_broken(record.end, "-", ERROR_FRAME, text);
            }
        }
    }

    fn add_frame(&mut self, at: Cycles, frame: &Frame, from_node: bool, station: Option<&str>) {
        let id = match frame.id {
            Id::Extended(id) if !frame.remote => id,
            Id::Extended(_) => {
                return self.add_foreign(at, station, frame, "not DroneCAN: remote frame");
            }
            Id::Standard(_) => {
                return self.add_foreign(at, station, frame, "not DroneCAN: 11-bit identifier");
            }
        };
        let data_type = CanId::parse(id).and_then(DataType::of);
        let transfer = match self.observer.push(id, frame.data(), bench::elapsed(at)) {
            // Frames of other protocols can look like parts of a transfer, or like a whole one.
            Observation::Partial if data_type.is_none() && self.dialect == Dialect::V0 => {
                return self.add_foreign(at, station, frame, self.without_known_type(id));
            }
            Observation::Complete(Decoded::V0(..)) if data_type.is_none() => {
                return self.add_foreign(at, station, frame, self.without_known_type(id));
            }
            Observation::Partial => return,
            Observation::Invalid(why) if data_type.is_some() && self.is_speaker(id) => {
                let who = station.unwrap_or("-");
                return self.add_broken(at, who, "invalid frame", format!("{frame} {why}"));
            }
            Observation::Invalid(why) => {
                return self.add_foreign(at, station, frame, &format!("not DroneCAN: {why}"));
            }
            Observation::Complete(transfer) => transfer,
        };
        self.speakers |= 1 << (id & 0x7F);
        if let Some((source, status, mut text)) = status_in(&transfer) {
            if from_node && self.knows_vendor_code && status.vendor_code != 0 {
                text += &format!(": {}", vendor_code::conditions(status.vendor_code).join(", "));
            }
            self.report(at, Event::Status(source, text));
            if from_node {
                self.set_node_status(at, source, status, transfer.dialect());
            }
        }
        if from_node {
            self.measured.keep(&transfer);
        }
        let origin = if from_node { Origin::Node } else { Origin::Other };
        let (who, name, text) = (transfer.endpoints(), transfer.name(), transfer.to_string());
        self.add_traffic(TrafficLine { at, origin, who, name, text });
    }

    /// Sets the node's status. If its dialect changed, the measurements that it sent in the old
    /// dialect are out of date and dropped.
    fn set_node_status(&mut self, at: Cycles, node: NodeId, status: NodeStatus, dialect: Dialect) {
        if dialect != self.dialect {
            self.measured = Measured::default();
        }
        self.dialect = dialect;
        self.status = Some((at, node, status));
    }

    /// True if the sender of a frame speaks DroneCAN. Frames of other protocols with 29 bits, such
    /// as J1939 and CANopen, may have the identifier of a known type. In the draft of 2014 the
    /// sender is elsewhere in the identifier, so there each does.
    fn is_speaker(&self, id: u32) -> bool {
        self.dialect != Dialect::V0 || self.speakers >> (id & 0x7F) & 1 != 0
    }

    fn without_known_type(&self, id: u32) -> &'static str {
        if self.is_speaker(id) { "of an unknown type" } else { "not DroneCAN: no known type" }
    }

    /// Adds a frame that is not part of a known DroneCAN transfer. Other protocols may share the
    /// bus, so this is not an error.
    fn add_foreign(&mut self, at: Cycles, station: Option<&str>, frame: &Frame, why: &str) {
        let text = format!("CAN frame {frame} ({why})");
        let (who, name) = (station.unwrap_or("-").to_owned(), String::from("CAN frame"));
        self.add_traffic(TrafficLine { at, origin: Origin::Foreign, who, name, text });
    }

    fn add_broken(&mut self, at: Cycles, who: &str, name: &str, text: String) {
        self.add_traffic(TrafficLine {
            at,
            origin: Origin::Broken,
            who: who.to_owned(),
            name: name.to_owned(),
            text,
        });
    }

    fn add_traffic(&mut self, line: TrafficLine) {
        self.report(line.at, Event::Traffic(line.clone()));
        self.traffic.push(line);
    }
}

/// The NodeStatus in a transfer: its sender, the status converted to v0, and the status in words.
fn status_in(transfer: &Decoded) -> Option<(NodeId, NodeStatus, String)> {
    let (status, text) = match transfer {
        Decoded::V0(_, Message::NodeStatus(status)) => (*status, status.to_string()),
        Decoded::Draft(_, draft::Message::NodeStatus(status)) => {
            ((*status).into(), format!("draft, {status}"))
        }
        _ => return None,
    };
    Some((transfer.source()?, status, text))
}

/// Name of an error state in ISO 11898-1.
pub fn error_state_name(state: &ErrorState) -> &'static str {
    match state {
        ErrorState::Active => "error active",
        ErrorState::Passive => "error passive",
        ErrorState::BusOff => "bus-off",
    }
}

/// Battery 3 at 12.6 V and 3.2 A, with this energy and charge left.
#[cfg(test)]
pub fn battery_info(remaining_wh: f32, charge: u8) -> bench::dronecan::BatteryInfo {
    use bench::dronecan::BatteryInfo;
    use half::f16;
    BatteryInfo {
        temperature: f16::NAN,
        voltage: f16::from_f32(12.6),
        current: f16::from_f32(3.2),
        average_power: f16::NAN,
        remaining_wh: f16::from_f32(remaining_wh),
        full_wh: f16::NAN,
        hours_to_full: f16::ZERO,
        flags: 1,
        health: 127,
        charge,
        charge_deviation: 127,
        battery: 3,
        model_instance: 0,
        model: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench::can::ErrorKind;

    const STATUS: [u8; 8] = [12, 0, 0, 0, 0, 0, 0, 0xC0];

    fn record(end: Cycles, id: u32, data: &[u8]) -> Record {
        let kind = RecordKind::Frame { frame: Frame::extended(id, data), from: None, acked: true };
        Record { start: end - 2000, end, bits: 125, kind }
    }

    /// The state after frames of the node (true) or of another station, a millisecond apart.
    fn after(frames: &[(bool, u32, &[u8])]) -> State {
        let mut state = State::new(1_000_000);
        for ((from_node, id, data), ms) in frames.iter().zip(1..) {
            let station = if *from_node { "node" } else { "other" };
            state.add_record(&record(ms * 16_000, *id, data), *from_node, Some(station));
        }
        state
    }

    fn last_text(state: &State) -> &str {
        &state.traffic.last().unwrap().text
    }

    #[test]
    fn a_status_of_the_node_is_kept_and_reported_and_that_of_another_is_not_its_own() {
        let mut state = after(&[(true, 0x1801_552A, &STATUS)]);
        let (at, node_id, status) = state.status.unwrap();
        assert_eq!((at, node_id.get(), status.uptime_s), (16_000, 42, 12));
        assert!(matches!(state.take_events()[0].1, Event::Status(..)));
        assert!(state.take_events().is_empty());
        assert_eq!(state.traffic.last().unwrap().origin, Origin::Node);
        assert_eq!(last_text(&state), "NodeStatus OK OPERATIONAL up 12 s vendor 0x0000");
        let state = after(&[(false, 0x1001_5501, &STATUS)]);
        assert_eq!(state.status, None);
        assert_eq!(state.traffic.last().unwrap().who, "1");
    }

    #[test]
    fn the_vendor_code_of_this_projects_program_is_reported_in_words() {
        let number = "WARNING OPERATIONAL up 12 s vendor 0x0420";
        for (knows_vendor_code, code, from_node, expected) in [
            (true, 0x0420_u16, true, &format!("{number}: frames lost, failsafe")[..]),
            (false, 0x0420, true, number),
            (true, 0x0420, false, number),
            (true, 0, true, "WARNING OPERATIONAL up 12 s vendor 0x0000"),
        ] {
            let mut state = State { knows_vendor_code, ..State::new(1_000_000) };
            let [low, high] = code.to_le_bytes();
            let status = [12, 0, 0, 0, 0x40, low, high, 0xC0];
            state.add_record(&record(16_000, 0x1801_552A, &status), from_node, None);
            let (_, event) = state.take_events().swap_remove(0);
            let Event::Status(_, text) = event else { panic!("{event:?}") };
            assert_eq!(text, expected, "{knows_vendor_code} {from_node}");
        }
    }

    #[test]
    fn a_status_and_a_measurement_of_the_draft_are_kept_and_those_of_v0_dropped() {
        let temperature: (bool, u32, &[u8]) = (true, 0x1804_5678, &[1, 0, 0xA9, 0x5C, 0, 0xC2]);
        let v0 = [(true, 0x1801_5578, &STATUS[..]), temperature];
        assert!(after(&v0).measured.temperature.is_some());
        let draft: [(bool, u32, &[u8]); 3] = [
            (true, 0x1135_E00B, &[0xEF, 0xCD, 0xAB, 0x02, 0xEF, 0xBE]),
            (true, 0x17CD_E008, &[23]),
            (false, 0x17C4_0409, &[90]),
        ];
        let mut state = after(&[&v0[..], &draft[..]].concat());
        let (at, node_id, status) = state.status.unwrap();
        assert_eq!((at, node_id.get(), state.dialect), (48_000, 120, Dialect::Draft));
        assert_eq!(status.to_string(), "WARNING OPERATIONAL up 11259375 s vendor 0xBEEF");
        let measured = (state.measured.temperature, state.measured.draft_measurement);
        assert_eq!(measured, (None, Some(23)));
        let events = state.take_events();
        let text = String::from("draft, WARNING up 11259375 s vendor 0xBEEF");
        assert!(events.contains(&(48_000, Event::Status(node_id, text))), "{events:?}");
        assert_eq!(state.traffic.last().unwrap().who, "1");
        assert_eq!(last_text(&state), "draft.ThesisCommand 90");
    }

    #[test]
    fn the_last_measurements_of_the_node_are_kept_and_those_of_others_are_not() {
        let data = [0x34, 0x12, 0x4D, 0x4A, 0x66, 0xC2, 0x06, 0xC5];
        assert_eq!(after(&[(false, 0x1804_4301, &data)]).measured.circuit, None);
        let state = after(&[(true, 0x1804_4378, &data)]);
        assert_eq!(state.measured.circuit.unwrap().circuit, 0x1234);
        let text = "CircuitStatus circuit 4660 12.60 V -3.20 A UNDERVOLTAGE OVERCURRENT";
        assert_eq!(last_text(&state), text);
        let state = after(&[
            (true, 0x1804_1578, &[3, 1, 0, 0, 0, 0, 0, 0xC1]),
            (true, 0x1804_1578, &[3, 0, 0, 0, 0x80, 0xBB, 0x45, 0xC2]),
        ]);
        let rpm = bench::dronecan::Rpm { sensor: 3, flags: 0, rpm: 6000.0 };
        assert_eq!(state.measured.rpm, Some(rpm));
        let relays = [(5, 1), (6, 0), (5, 0), (6, 3)]
            .map(|(id, status)| [id, 0x00, 0x7E, 0x00, 0x7E, status, 0, 0xC0]);
        let state = after(&relays.each_ref().map(|data| (true, 0x1804_2F78, &data[..])));
        assert_eq!(state.measured.hardpoints, [(5, 0), (6, 3)].into());
        let state = after(&[
            (true, 0x1804_4478, &[0x77, 0x12, 0xA9, 0x5C, 0x40, 0x4A, 0x00, 0x83]),
            (true, 0x1804_4478, &[0x49, 0xFF, 0x7F, 0x80, 0x4B, 0x10, 0x4C, 0x23]),
            (true, 0x1804_4478, &[0x00, 0x00, 0x21, 0x1F, 0xEE, 0x7F, 0x07, 0x03]),
            (true, 0x1804_4478, &[0x00, 0x00, 0x00, 0x00, 0x63]),
        ]);
        assert_eq!(state.measured.battery.as_ref().unwrap().charge, 92);
        let text = "power.BatteryInfo battery 7 12.50 V 10.00 A 92 % 15.0 Wh 25.1 C OVERLOAD";
        assert_eq!(last_text(&state), text);
    }

    #[test]
    fn the_load_is_measured_over_the_last_second() {
        let mut state = State::new(1_000_000);
        for ms in 1..=2000 {
            state.add_record(&record(ms * 16_000, 0x1001_5501, &STATUS), false, None);
        }
        state.advance_to(2 * F_CPU_HZ);
        assert_eq!(state.bus.frames, 2000);
        assert_eq!(state.bus.frames_per_second(), 1000);
        assert!((state.bus.load_percent(state.now) - 12.8).abs() < 0.01);
        state.advance_to(4 * F_CPU_HZ);
        assert_eq!(state.bus.load_percent(state.now), 0.0);
    }

    #[test]
    fn error_frames_and_foreign_frames_are_counted_and_shown() {
        let mut state = State::new(1_000_000);
        let mut broken = record(16_000, 0, &[]);
        broken.kind = RecordKind::ErrorFrame { kind: Some(ErrorKind::Stuff), from: None };
        state.add_record(&broken, false, None);
        assert_eq!(state.bus.error_frames, 1);
        assert_eq!(last_text(&state), "error frame: stuff error");
        let mut foreign = record(32_000, 0, &[]);
        foreign.kind =
            RecordKind::Frame { frame: Frame::standard(0x123, &[1]), from: None, acked: false };
        state.add_record(&foreign, false, None);
        assert_eq!(last_text(&state), "CAN frame 123#01 (not DroneCAN: 11-bit identifier)");
        assert_eq!(state.bus.unacknowledged, 1);
    }

    /// Other protocols may use identifiers and last bytes that look like a transfer's.
    #[test]
    fn frames_of_other_protocols_are_not_dronecan() {
        let mut state = State::new(1_000_000);
        let mut shown = |id, data: &[u8]| {
            state.add_record(&record(16_000, id, data), false, Some("other"));
            last_text(&state).to_owned()
        };
        // J1939's EEC1 and VD. The last bytes are those of one frame, of the first of several, and
        // of one that continues.
        for id in [0x0CF0_0400, 0x18FE_E017] {
            for tail in [0xC1, 0x81, 0x21] {
                let text = shown(id, &[0xAA, tail]);
                assert!(text.contains("(not DroneCAN: "), "{id:08X} {tail:02X}: {text}");
            }
        }
        // The identifier of NodeStatus, from a station that has never sent a whole one.
        let text = shown(0x1801_552A, &[0xAA, 0x21]);
        assert!(text.starts_with("CAN frame 1801552A#AA21 (not DroneCAN: "), "{text}");
        // A node that has sent NodeStatus has types of its maker, too.
        shown(0x1801_550A, &[0, 0, 0, 0, 0, 0, 0, 0xC0]);
        assert_eq!(shown(0x184E_8A0A, &[1, 0xC0]), "CAN frame 184E8A0A#01C0 (of an unknown type)");
    }
}
