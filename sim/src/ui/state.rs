//! What a user may want to know of the bench, collected as simulated time passes.
//!
//! Plain data and the rules that fill it: no bench, no terminal, no wall clock. The scene feeds it, the live view draws
//! it, the plain view prints the news in it. Histories are bounded; counters are not.

use super::history::Log;
use super::mistakes::Mistakes;
use super::traffic::Traffic;
use super::vendor_code;
use crate::fault::Fault;
use bench::board::SpiUse;
use bench::budget::Budget;
use bench::can::{ErrorState, Frame, Id, Record, RecordKind};
use bench::dronecan::{
    CanId, CircuitStatus, DataType, Dialect, Heard, Message, NodeId, NodeStatus, Observer, Said, Temperature, draft,
};
use bench::wiring::Wiring;
use bench::{Cycles, F_CPU_HZ};
use bus_load::measured::LoadByType;
use std::cell::RefCell;
use std::collections::VecDeque;

/// Load and rates are those of the last second.
const RATE_WINDOW: Cycles = F_CPU_HZ;
/// A line of the serial monitor is cut here, should the node forget to end it.
const SERIAL_LINE_MAX: usize = 200;
/// A PWM output without a pulse for this long is off: several of the longest usual servo periods.
const PULSE_TIMEOUT: Cycles = F_CPU_HZ / 10;
/// Bits between two frames, which no other frame can have.
const INTERMISSION_BITS: u32 = 3;

/// Lost frames and resets that are kept for the report: the first of them; all are counted.
const LOST_FRAMES_MAX: usize = 100;
const RESETS_MAX: usize = 100;
const HINTS_MAX: usize = 20;

/// Where a line of traffic comes from, for its colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The node under test.
    Node,
    /// Any other station.
    Other,
    /// Valid on CAN, and not DroneCAN.
    Foreign,
    /// Not a valid transfer of a known data type, or an error frame.
    Broken,
}

/// One transfer, or one thing that went wrong, on the bus.
#[derive(Clone, Debug, PartialEq)]
pub struct TrafficLine {
    pub at: Cycles,
    pub origin: Origin,
    /// Sender as text: "1", "anon", "127>42", "-".
    pub who: String,
    /// Type for counting.
    pub name: String,
    /// What it says.
    pub text: String,
}

/// Something worth a line in the plain view.
#[derive(Clone, Debug, PartialEq)]
pub enum News {
    Serial(String),
    Traffic(TrafficLine),
    /// What a node says of its condition.
    Status(NodeId, String),
    ErrorFrame(String),
    /// A driver mistake that the models noticed, the first of its kind.
    Violation(String),
    /// Something that the author of the program will want to know.
    Hint(String),
    /// A frame that passed the filters and was lost, because both receive buffers were full.
    Lost(String),
    /// The node's program is broken beyond repair.
    Crash(String),
    /// The controller's error state changed.
    Controller(String),
    /// Something that the user did to the bench.
    Fault(String),
    /// The board that the node runs on.
    Board(String),
    /// The AVR was reset.
    Reset(String),
    /// Something about the programs that are joined to the bench.
    Link(String),
    /// What the autopilot has learned of a node, or given to it.
    Node(String),
    /// The light's new brightness, in per cent.
    Light(u32),
}

/// Pulses on the servo output.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Servo {
    /// Width of the last pulse; `None` while there are none.
    pub pulse: Option<Cycles>,
    /// From the start of the pulse before to the start of the last.
    pub period: Option<Cycles>,
    pub last_start: Cycles,
    pub count: u64,
    /// Widths of the shortest and the longest pulse so far.
    pub shortest: Option<Cycles>,
    pub longest: Option<Cycles>,
}

/// Counters of the bus.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BusState {
    pub bit_rate: u32,
    pub frames: u64,
    pub error_frames: u64,
    /// Frames that nobody acknowledged.
    pub unacknowledged: u64,
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

    fn forget(&mut self, now: Cycles) {
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
    /// Frames that found both receive buffers full.
    pub overflows: u64,
}

impl Default for Controller {
    fn default() -> Controller {
        Controller { mode: String::from("?"), tec: 0, rec: 0, error_state: ErrorState::Active, overflows: 0 }
    }
}

/// How long received frames waited in the chip: from the end of the frame to RXnIF cleared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Latency {
    pub last: Option<Cycles>,
    pub worst: Option<Cycles>,
}

/// What the firmware uses of the chip, in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// .text + .data.
    pub flash: u32,
    /// .data + .bss; `None` of a chip with a bootloader: an update can have brought another program.
    pub statics: Option<u32>,
    /// Deepest stack so far, in programs that paint it.
    pub stack: Option<u32>,
    /// What it may use, in programs that say for which board they are.
    pub limits: Option<Budget>,
}

/// What the autopilot is doing, in words.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AutopilotState {
    pub node_id: u8,
    pub deflection: f64,
    /// All its actuators move.
    pub moves_all: bool,
    pub motors: u8,
    pub sweeping: bool,
    pub silent: bool,
    pub armed: bool,
    pub dialect: Dialect,
    /// Flight controller that it is like.
    pub profile: String,
    pub command_type: String,
    pub commands_sent: u64,
}

/// Everything. Public fields are for the views to read.
#[derive(Default)]
pub struct State {
    pub now: Cycles,
    /// The board of the node under test.
    pub wiring: Wiring,
    pub servo: Servo,
    /// Start and width of the last pulse of each output from the second on, if the board has them.
    pub outputs: Vec<Option<(Cycles, Cycles)>>,
    /// Brightness of the light, in per cent.
    pub light_percent: u32,
    /// Temperature at the sensor, in degrees Celsius.
    pub sensor_c: f64,
    pub temperature: Option<Temperature>,
    /// Millivolts at the inputs for the voltage and the current of the circuit.
    pub circuit_inputs_mv: [u32; 2],
    /// What the node measures there.
    pub circuit: Option<CircuitStatus>,
    pub thesis_temperature_c: Option<u8>,
    /// What the node measures in the draft: degrees Celsius, or how often its button was pressed.
    pub draft_measurement: Option<u8>,
    /// Last NodeStatus of the node under test, and when it came. One of the draft is put as v0 has it.
    pub status: Option<(Cycles, NodeId, NodeStatus)>,
    /// In which dialect that was.
    pub dialect: Dialect,
    /// The program is this project's, so its vendor-specific status code can be put in words.
    pub knows_vendor_code: bool,
    pub bus: BusState,
    /// What the view shows as load by node and type; it forgets what is old when it is drawn.
    pub load_by_type: RefCell<LoadByType>,
    pub controller: Controller,
    pub latency: Latency,
    pub traffic: Traffic,
    pub serial: Log<(Cycles, String)>,
    pub mistakes: Mistakes,
    /// What the author of the program will want to know, each once.
    pub hints: Vec<String>,
    /// The first frames that the node lost.
    pub lost_frames: Vec<(Cycles, Frame)>,
    /// Frames that came through the node's filters, lost ones too, and frames of the node.
    pub frames_for_node: u64,
    pub frames_of_node: u64,
    pub spi: SpiUse,
    /// Resets since power-on: when, and why.
    pub resets: Vec<(Cycles, String)>,
    pub resets_total: u64,
    pub crash: Option<String>,
    pub memory: Memory,
    /// None if it was left out.
    pub autopilot: Option<AutopilotState>,
    /// What is joined to the bench, a line each.
    pub links: Vec<String>,
    /// Lasting faults that are on.
    pub active_faults: Vec<Fault>,
    serial_line: Option<(Cycles, String)>,
    observer: Observer,
    news: Vec<(Cycles, News)>,
}

impl State {
    /// Nothing has happened yet.
    pub fn new(bit_rate: u32) -> State {
        let mut state = State::default();
        state.bus.bit_rate = bit_rate;
        state.load_by_type = RefCell::new(LoadByType::new(bit_rate));
        state
    }

    /// What happened since the last call, in order of time.
    pub fn take_news(&mut self) -> Vec<(Cycles, News)> {
        self.news.sort_by_key(|(at, _)| *at);
        std::mem::take(&mut self.news)
    }

    /// Says something to the user.
    pub fn tell(&mut self, at: Cycles, news: News) {
        self.news.push((at, news));
    }

    /// Simulated time has come to `now`.
    pub fn pass(&mut self, now: Cycles) {
        self.now = now;
        self.bus.forget(now);
        if now.saturating_sub(self.servo.last_start) > PULSE_TIMEOUT {
            self.servo.pulse = None;
            self.servo.period = None;
        }
        for output in &mut self.outputs {
            *output = output.filter(|(start, _)| now.saturating_sub(*start) <= PULSE_TIMEOUT);
        }
    }

    /// Whole pulses of the outputs from the second on: start and width.
    pub fn output_pulses(&mut self, last: impl IntoIterator<Item = Option<(Cycles, Cycles)>>) {
        let last: Vec<_> = last.into_iter().collect();
        self.outputs.resize(last.len(), None);
        for (output, pulse) in self.outputs.iter_mut().zip(last) {
            *output = pulse.or(*output);
        }
    }

    /// Outputs from the second to the last that gives pulses: widths, and none of those that give no pulse.
    pub fn output_widths(&self) -> Vec<Option<Cycles>> {
        let count = self.outputs.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
        self.outputs[..count].iter().map(|output| output.map(|(_, width)| width)).collect()
    }

    /// A whole servo pulse.
    pub fn pulse(&mut self, start: Cycles, width: Cycles, period: Option<Cycles>) {
        let servo = &mut self.servo;
        servo.period = period.filter(|period| *period < PULSE_TIMEOUT);
        servo.pulse = Some(width);
        servo.last_start = start;
        servo.count += 1;
        servo.shortest = Some(servo.shortest.map_or(width, |shortest| shortest.min(width)));
        servo.longest = servo.longest.max(Some(width));
    }

    /// How bright the light is, 0 to 1.
    pub fn light(&mut self, at: Cycles, brightness: f64) {
        let percent = (brightness * 100.0).round() as u32;
        if percent != self.light_percent {
            self.light_percent = percent;
            self.tell(at, News::Light(percent));
        }
    }

    /// A byte from the node's serial port. Bytes that do not print are shown as `\x..`.
    pub fn serial_byte(&mut self, at: Cycles, byte: u8) {
        let (_, line) = self.serial_line.get_or_insert((at, String::new()));
        match byte {
            b'\r' => return,
            b'\n' => {}
            b' '..=b'~' => line.push(char::from(byte)),
            _ => line.push_str(&format!("\\x{byte:02x}")),
        }
        if byte == b'\n' || line.len() >= SERIAL_LINE_MAX {
            let (at, line) = self.serial_line.take().expect("it was just written to");
            self.tell(at, News::Serial(line.clone()));
            self.serial.push((at, line));
        }
    }

    /// A driver mistake.
    pub fn violation(&mut self, at: Cycles, text: String) {
        if self.mistakes.add(at, &text) {
            self.tell(at, News::Violation(text));
        }
    }

    /// Something that the author of the program will want to know.
    /// A program that goes back and forth gets each text once, and a program with ever new ones the first of them.
    pub fn hint(&mut self, at: Cycles, text: String) {
        if self.hints.len() < HINTS_MAX && !self.hints.contains(&text) {
            self.hints.push(text.clone());
            self.tell(at, News::Hint(text));
        }
    }

    /// `count` divided by the frames that the node has received and sent; none without a frame.
    pub fn per_node_frame(&self, count: u64) -> Option<f64> {
        let frames = self.frames_for_node + self.frames_of_node;
        (frames > 0).then(|| count as f64 / frames as f64)
    }

    /// A frame that the node lost.
    pub fn lost(&mut self, at: Cycles, frame: Frame) {
        if self.lost_frames.len() < LOST_FRAMES_MAX {
            self.lost_frames.push((at, frame));
        }
        self.tell(at, News::Lost(format!("frame lost, both receive buffers were full: {frame}")));
    }

    /// The AVR was reset.
    pub fn reset(&mut self, at: Cycles, cause: String) {
        self.resets_total += 1;
        if self.resets.len() < RESETS_MAX {
            self.resets.push((at, cause.clone()));
        }
        self.tell(at, News::Reset(format!("the AVR was reset: {cause}")));
    }

    /// The node's program ended; only the first report counts.
    pub fn crashed(&mut self, at: Cycles, text: String) {
        if self.crash.is_none() {
            self.tell(at, News::Crash(text.clone()));
            self.crash = Some(text);
        }
    }

    /// Looks at the controller.
    pub fn look_at_controller(&mut self, controller: Controller) {
        if controller.error_state != self.controller.error_state {
            let text = format!(
                "{} (TEC {}, REC {})",
                error_state_name(&controller.error_state),
                controller.tec,
                controller.rec
            );
            self.tell(self.now, News::Controller(text));
        }
        self.controller = controller;
    }

    /// How long the driver left a received frame in the chip.
    pub fn served(&mut self, latency: Cycles) {
        self.latency.last = Some(latency);
        self.latency.worst = self.latency.worst.max(Some(latency));
    }

    /// Something ended on the bus. `from_node`: it came from the node under test; `station` is the sender's name.
    pub fn record(&mut self, record: &Record, from_node: bool, station: Option<&str>) {
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
                self.frame(record.end, frame, from_node, station);
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
                self.tell(record.end, News::ErrorFrame(text.clone()));
                self.broken(record.end, "-", "error frame", text);
            }
        }
    }

    fn frame(&mut self, at: Cycles, frame: &Frame, from_node: bool, station: Option<&str>) {
        let id = match frame.id {
            Id::Extended(id) if !frame.remote => id,
            Id::Extended(_) => return self.foreign(at, station, frame, "remote frame"),
            Id::Standard(_) => return self.foreign(at, station, frame, "11-bit identifier"),
        };
        let said = match self.observer.push(id, frame.data(), bench::elapsed(at)) {
            Heard::Partial => return,
            Heard::Invalid(why) if CanId::parse(id).is_some_and(|id| DataType::of(id).is_some()) => {
                let who = station.unwrap_or("-");
                return self.broken(at, who, "invalid frame", format!("{frame} {why}"));
            }
            Heard::Invalid(why) => return self.foreign(at, station, frame, why),
            Heard::Said(said) => said,
        };
        if let Some((source, status, mut text)) = status_in(&said) {
            if from_node && self.knows_vendor_code && status.vendor_code != 0 {
                text += &format!(": {}", vendor_code::conditions(status.vendor_code).join(", "));
            }
            self.tell(at, News::Status(source, text));
            if from_node {
                self.node_status(at, source, status, said.dialect());
            }
        }
        if from_node {
            self.measurement(&said);
        }
        let origin = if from_node { Origin::Node } else { Origin::Other };
        self.traffic_line(TrafficLine { at, origin, who: said.who(), name: said.name(), text: said.to_string() });
    }

    /// A node that changes its dialect begins anew: what it measured in the other one is of the past.
    fn node_status(&mut self, at: Cycles, node: NodeId, status: NodeStatus, dialect: Dialect) {
        if dialect != self.dialect {
            (self.temperature, self.thesis_temperature_c, self.draft_measurement) = (None, None, None);
            self.circuit = None;
        }
        self.dialect = dialect;
        self.status = Some((at, node, status));
    }

    fn measurement(&mut self, said: &Said) {
        match said {
            Said::V0(_, Message::Temperature(temperature)) => self.temperature = Some(*temperature),
            Said::V0(_, Message::CircuitStatus(circuit)) => self.circuit = Some(*circuit),
            Said::V0(_, Message::ThesisTemperature(degrees)) => self.thesis_temperature_c = Some(*degrees),
            Said::Draft(_, draft::Message::ThesisMeasurement(number)) => self.draft_measurement = Some(*number),
            _ => {}
        }
    }

    /// A frame that is no part of a DroneCAN transfer. Many a bus carries other protocols, and that is no fault.
    fn foreign(&mut self, at: Cycles, station: Option<&str>, frame: &Frame, why: &str) {
        let text = format!("CAN frame {frame} (not DroneCAN: {why})");
        let (who, name) = (station.unwrap_or("-").to_owned(), String::from("CAN frame"));
        self.traffic_line(TrafficLine { at, origin: Origin::Foreign, who, name, text });
    }

    fn broken(&mut self, at: Cycles, who: &str, name: &str, text: String) {
        self.traffic_line(TrafficLine { at, origin: Origin::Broken, who: who.to_owned(), name: name.to_owned(), text });
    }

    fn traffic_line(&mut self, line: TrafficLine) {
        self.tell(line.at, News::Traffic(line.clone()));
        self.traffic.push(line);
    }
}

/// The NodeStatus in a transfer: of whom, as v0 has it, and in words.
fn status_in(said: &Said) -> Option<(NodeId, NodeStatus, String)> {
    let (status, text) = match said {
        Said::V0(_, Message::NodeStatus(status)) => (*status, status.to_string()),
        Said::Draft(_, draft::Message::NodeStatus(status)) => ((*status).into(), format!("draft, {status}")),
        _ => return None,
    };
    Some((said.source()?, status, text))
}

/// Name of an error state, as ISO 11898-1 has it.
pub fn error_state_name(state: &ErrorState) -> &'static str {
    match state {
        ErrorState::Active => "error active",
        ErrorState::Passive => "error passive",
        ErrorState::BusOff => "bus-off",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench::can::ErrorKind;

    const STATUS: [u8; 8] = [12, 0, 0, 0, 0, 0, 0, 0xC0];

    fn record(end: Cycles, id: u32, data: &[u8]) -> Record {
        Record {
            start: end - 2000,
            end,
            bits: 125,
            kind: RecordKind::Frame { frame: Frame::extended(id, data), from: None, acked: true },
        }
    }

    #[test]
    fn a_status_of_the_node_is_kept_and_told() {
        let mut state = State::new(1_000_000);
        state.record(&record(16_000, 0x1801_552A, &STATUS), true, Some("node"));
        let (at, node_id, status) = state.status.unwrap();
        assert_eq!((at, node_id.get(), status.uptime_s), (16_000, 42, 12));
        let news = state.take_news();
        assert!(matches!(news[0].1, News::Status(..)));
        assert!(state.take_news().is_empty());
        let line = state.traffic.last().unwrap();
        assert_eq!(line.origin, Origin::Node);
        assert_eq!(line.text, "NodeStatus OK OPERATIONAL up 12 s vendor 0x0000");
    }

    #[test]
    fn the_vendor_code_of_this_projects_program_is_told_in_words() {
        let told = |knows_vendor_code, code: u16, from_node| {
            let mut state = State { knows_vendor_code, ..State::new(1_000_000) };
            let [low, high] = code.to_le_bytes();
            state.record(&record(16_000, 0x1801_552A, &[12, 0, 0, 0, 0x40, low, high, 0xC0]), from_node, None);
            match state.take_news().swap_remove(0).1 {
                News::Status(_, text) => text,
                other => panic!("{other:?}"),
            }
        };
        let number = "WARNING OPERATIONAL up 12 s vendor 0x0420";
        assert_eq!(told(true, 0x0420, true), format!("{number}: frames lost, failsafe"));
        assert_eq!(told(false, 0x0420, true), number);
        assert_eq!(told(true, 0x0420, false), number, "the code of another node");
        assert_eq!(told(true, 0, true), "WARNING OPERATIONAL up 12 s vendor 0x0000");
    }

    #[test]
    fn a_node_of_the_draft_is_followed_too() {
        let mut state = State::new(1_000_000);
        state.record(&record(8_000, 0x1801_5578, &STATUS), true, Some("node"));
        state.record(&record(9_000, 0x1804_5678, &[1, 0, 0xA9, 0x5C, 0, 0xC2]), true, Some("node"));
        assert!(state.temperature.is_some());
        state.record(&record(16_000, 0x1135_E00B, &[0xEF, 0xCD, 0xAB, 0x02, 0xEF, 0xBE]), true, Some("node"));
        state.record(&record(17_000, 0x17CD_E008, &[23]), true, Some("node"));
        state.record(&record(18_000, 0x17C4_0409, &[90]), false, Some("autopilot"));
        let (at, node_id, status) = state.status.unwrap();
        assert_eq!((at, node_id.get(), state.dialect), (16_000, 120, Dialect::Draft));
        assert_eq!(status.to_string(), "WARNING OPERATIONAL up 11259375 s vendor 0xBEEF");
        assert_eq!((state.temperature, state.draft_measurement), (None, Some(23)));
        let news = state.take_news();
        let told = News::Status(node_id, String::from("draft, WARNING up 11259375 s vendor 0xBEEF"));
        assert!(news.contains(&(16_000, told)), "{news:?}");
        let line = state.traffic.last().unwrap();
        assert_eq!((line.who.as_str(), line.text.as_str()), ("1", "draft.ThesisCommand 90"));
    }

    #[test]
    fn the_circuit_that_the_node_measures_is_kept() {
        let mut state = State::new(1_000_000);
        let said = [0x34, 0x12, 0x4D, 0x4A, 0x66, 0xC2, 0x06, 0xC5];
        state.record(&record(16_000, 0x1804_4301, &said), false, Some("other"));
        assert_eq!(state.circuit, None);
        state.record(&record(32_000, 0x1804_4378, &said), true, Some("node"));
        assert_eq!(state.circuit.unwrap().circuit, 0x1234);
        assert_eq!(
            state.traffic.last().unwrap().text,
            "CircuitStatus circuit 4660 12.60 V -3.20 A UNDERVOLTAGE OVERCURRENT"
        );
    }

    #[test]
    fn outputs_behind_the_last_pulse_are_left_out() {
        let mut state = State::new(1_000_000);
        assert_eq!(state.output_widths(), []);
        state.output_pulses([None, Some((0, 16_000)), None, Some((0, 24_000)), None]);
        assert_eq!(state.output_widths(), [None, Some(16_000), None, Some(24_000)]);
    }

    #[test]
    fn a_status_of_another_is_not_taken_for_the_nodes() {
        let mut state = State::new(1_000_000);
        state.record(&record(16_000, 0x1001_5501, &STATUS), false, None);
        assert_eq!(state.status, None);
        assert_eq!(state.traffic.last().unwrap().who, "1");
    }

    #[test]
    fn load_is_that_of_the_last_second() {
        let mut state = State::new(1_000_000);
        for ms in 1..=2000 {
            state.record(&record(ms * 16_000, 0x1001_5501, &STATUS), false, None);
        }
        state.pass(2 * F_CPU_HZ);
        assert_eq!(state.bus.frames, 2000);
        assert_eq!(state.bus.frames_per_second(), 1000);
        assert!((state.bus.load_percent(state.now) - 12.8).abs() < 0.01);
        state.pass(4 * F_CPU_HZ);
        assert_eq!(state.bus.load_percent(state.now), 0.0);
    }

    #[test]
    fn serial_bytes_become_lines() {
        let mut state = State::new(1_000_000);
        for (at, byte) in (100..).zip(*b"node 42\r\n\x07") {
            state.serial_byte(at, byte);
        }
        assert_eq!(state.serial.last(), Some(&(100, String::from("node 42"))));
        for byte in *b"x\n" {
            state.serial_byte(200, byte);
        }
        assert_eq!(state.serial.last().unwrap().1, "\\x07x");
    }

    #[test]
    fn a_servo_without_pulses_is_off_after_a_tenth_of_a_second() {
        let mut state = State::new(1_000_000);
        state.pulse(320_000, 24_000, None);
        assert_eq!(state.servo.period, None);
        state.pulse(640_000, 24_016, Some(320_000));
        assert_eq!(state.servo.period, Some(320_000));
        state.pass(640_000 + PULSE_TIMEOUT);
        assert_eq!(state.servo.pulse, Some(24_016));
        state.pass(640_000 + PULSE_TIMEOUT + 1);
        assert_eq!(state.servo.pulse, None);
        assert_eq!(state.servo.count, 2);
    }

    #[test]
    fn error_frames_and_foreign_frames_are_counted_and_shown() {
        let mut state = State::new(1_000_000);
        let mut broken = record(16_000, 0, &[]);
        broken.kind = RecordKind::ErrorFrame { kind: Some(ErrorKind::Stuff), from: None };
        state.record(&broken, false, None);
        assert_eq!(state.bus.error_frames, 1);
        assert_eq!(state.traffic.last().unwrap().text, "error frame: stuff error");
        let mut foreign = record(32_000, 0, &[]);
        foreign.kind = RecordKind::Frame { frame: Frame::standard(0x123, &[1]), from: None, acked: false };
        state.record(&foreign, false, None);
        assert_eq!(state.traffic.last().unwrap().text, "CAN frame 123#01 (not DroneCAN: 11-bit identifier)");
        assert_eq!(state.bus.unacknowledged, 1);
    }

    #[test]
    fn worst_latency_is_the_largest() {
        let mut state = State::new(1_000_000);
        for latency in [100, 300, 200] {
            state.served(latency);
        }
        assert_eq!(state.latency.last, Some(200));
        assert_eq!(state.latency.worst, Some(300));
    }
}
