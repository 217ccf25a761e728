//! What the web page shows and does: the world as JSON, and the page's controls.
//!
//! The page asks for a snapshot and for the new events with each picture. Frames keep a number, by
//! which the page asks for the details of one.

use std::collections::VecDeque;

use anyhow::{Context, Result, anyhow, ensure};
use bench::autopilot::{Moves, Profile, Settings};
use bench::avr::{Avr, Firmware, ResetCause};
use bench::board::PULSE_TIMEOUT;
use bench::boards;
use bench::bus_log::{BusLog, Format};
use bench::can::{BusStats, Record, RecordKind};
use bench::dronecan::{
    Decoded, Dialect, LightCommand, Message, NodeStatus, Observer, Value, draft,
};
use bench::fault::{ALL, Fault};
use bench::findings;
use bench::mcp2515::Fate;
use bench::node_ids::{self, CAN_NODE};
use bench::script;
use bench::wiring::{Pin, Wiring};
use bench::{Cycles, F_CPU_HZ, elapsed, vendor_code};
use serde_json::{Value as Json, json};

use crate::bits::Ack;
use crate::spi::Transaction;
use crate::traffic::{Described, describe, seconds, wire};
use crate::world::{Happened, World};

/// Frames, and transactions on the SPI, whose details the page can ask for.
const KEPT: usize = 4096;
/// Frames of a log of the bus: at least 20 seconds.
const LOGGED: usize = 200_000;
/// Default of the parameter LIGHT_ID.
const LIGHT_ID: u8 = 0;
/// Value of OUTn_TYPE for a motor.
const MOTOR: u8 = 1;
/// Node ID of the second board.
const SECOND_NODE: i64 = 121;
/// The settings of docs/autopilots.md for the motors of a quadcopter.
const FOUR_MOTORS: [(&str, i64); 10] = [
    ("OUT_COUNT", 4),
    ("OUT1_TYPE", 1),
    ("OUT1_ID", 0),
    ("OUT2_TYPE", 1),
    ("OUT2_ID", 1),
    ("OUT3_TYPE", 1),
    ("OUT3_ID", 2),
    ("OUT4_TYPE", 1),
    ("OUT4_ID", 3),
    ("ESC_RATE", 400),
];
const SECOND_MOTORS: u8 = 4;
/// Bus load is measured over this time.
const LOAD_WINDOW: Cycles = F_CPU_HZ / 4;

/// A frame or an error frame that the page has been told of.
struct Shown {
    number: u64,
    record: Record,
    from: String,
    text: String,
    /// Time at which the node's driver had fetched it.
    fetched_at: Option<Cycles>,
}

/// The world of the page.
pub struct Page {
    world: World,
    observer: Observer,
    frames: VecDeque<Shown>,
    /// For a log of the bus.
    records: VecDeque<Record>,
    transactions: VecDeque<Transaction>,
    next_number: u64,
    events: Vec<Json>,
    /// Start and width of the last pulse of each output.
    pulses: Vec<Option<(Cycles, Cycles)>>,
    /// The same of the motors of the second board; empty without one.
    second_pulses: Vec<Option<(Cycles, Cycles)>>,
    status: Option<(Cycles, NodeStatus)>,
    temperature_c: Option<f64>,
    /// Time of the line of the serial monitor with which the present failsafe began.
    failsafe_at: Option<Cycles>,
    /// Bus load, 0 to 1, and the totals at the start of the present window.
    load: f64,
    window: (Cycles, BusStats),
    lost: u64,
    /// Longest time that a received frame waited for the driver.
    worst_latency: Cycles,
    knows_vendor_code: bool,
}

/// The settings of an autopilot whose actuators all move, with a name: `plain`, `ardupilot`,
/// `ardupilot-pwm`, `px4` or `thesis`, which speaks the draft of 2014.
fn settings(name: &str) -> Result<Settings> {
    let settings = match name {
        "plain" => Settings::of(Profile::Plain),
        "ardupilot" => Settings::of(Profile::Ardupilot),
        "ardupilot-pwm" => Settings::of(Profile::ArdupilotPwm),
        "px4" => Settings::of(Profile::Px4),
        "thesis" => Settings::of(Profile::Thesis).in_dialect(Dialect::Draft),
        _ => anyhow::bail!("there is no autopilot \"{name}\""),
    };
    Ok(Settings { moves: Moves::All, ..settings })
}

impl Page {
    /// A board with a program, and an autopilot with a name of [`settings`]. A program that is not
    /// this project's has no known vendor-specific status code, and gets hints.
    ///
    /// # Errors
    /// If the wiring in the program is impossible, or there is no such autopilot.
    pub fn new(
        avr: Avr,
        wiring: &Wiring,
        bit_rate: u32,
        knows_vendor_code: bool,
        autopilot: &str,
    ) -> Result<Page> {
        let mut world = World::new(avr, wiring, bit_rate, settings(autopilot)?)?;
        if !knows_vendor_code {
            world.give_hints();
        }
        let stats = world.bench.bus().stats();
        let outputs = world.board().wiring().outputs.len() + 1;
        Ok(Page {
            world,
            observer: Observer::new(),
            frames: VecDeque::new(),
            records: VecDeque::new(),
            transactions: VecDeque::new(),
            next_number: 0,
            events: Vec::new(),
            pulses: vec![None; outputs],
            second_pulses: Vec::new(),
            status: None,
            temperature_c: None,
            failsafe_at: None,
            load: 0.0,
            window: (0, stats),
            lost: 0,
            worst_latency: 0,
            knows_vendor_code,
        })
    }

    /// The world, for its controls.
    pub fn world(&mut self) -> &mut World {
        &mut self.world
    }

    /// Simulates until `until`.
    pub fn advance(&mut self, until: Cycles) {
        self.world.advance(until);
        let happened = self.world.take();
        self.show(happened);
        let now = self.world.now();
        if now - self.window.0 >= LOAD_WINDOW {
            let stats = self.world.bench.bus().stats();
            self.load = stats.load_since(&self.window.1);
            self.window = (now, stats);
        }
    }

    /// What is wired to what, a JSON object: the pin of each signal, what each board is, and the
    /// values of its chips that are not typical.
    pub fn wiring(&mut self) -> String {
        let corner = self.world.board().corner().to_string();
        let wiring = self.world.board().wiring();
        let pin = |pin: Option<Pin>| pin.map(|pin| pin.to_string());
        let shield = boards::find("shields", &wiring.shield);
        json!({
            "text": wiring.to_string(),
            "corner": corner,
            "board": wiring.board_title(),
            "chip": wiring.chip.to_string(),
            "shield": wiring.shield_title(),
            "is_wired": shield.is_none_or(|entry| entry.get("is_wired").is_some()),
            "crystal_mhz": wiring.crystal_mhz,
            "cs": wiring.cs.to_string(),
            "int": wiring.int.to_string(),
            "sensor": wiring.sensor.to_string(),
            "light": pin(wiring.light),
            "button": pin(wiring.button),
        })
        .to_string()
    }

    /// Replaces the autopilot.
    ///
    /// # Errors
    /// If there is no autopilot of this name.
    pub fn set_autopilot(&mut self, name: &str) -> Result<()> {
        self.world.replace_autopilot(settings(name)?);
        Ok(())
    }

    /// Begins a fault, or ends it.
    ///
    /// # Errors
    /// If there is no fault of this name.
    pub fn inject(&mut self, name: &str) -> Result<()> {
        let fault = name.parse::<Fault>().map_err(anyhow::Error::msg)?;
        self.world.inject(fault);
        Ok(())
    }

    /// Plays a script of `sim`, or a recording of a bus. Returns in words what it has.
    ///
    /// # Errors
    /// If a line is invalid: its number, and the reason.
    pub fn play(&mut self, script: &[u8]) -> Result<String> {
        let text = script::text(script.to_owned()).map_err(anyhow::Error::msg)?;
        let lines =
            script::parse(&text).map_err(|(line, error)| anyhow!("line {line}: {error}"))?;
        let (frames, events) = self.world.play(lines);
        Ok(format!("{frames} frames and {events} events"))
    }

    /// The bus since power-on, at most its last [`LOGGED`] frames.
    pub fn bus_log(&self, format: Format) -> Vec<u8> {
        let (mut log, mut bytes) = BusLog::new(format);
        for record in &self.records {
            log.add(record, &mut bytes);
        }
        bytes
    }

    /// Commands the brightness of the node's light, 0 to 1.
    pub fn set_light(&mut self, brightness: f64) {
        let part = |full: u8| (brightness.clamp(0.0, 1.0) * f64::from(full)).round() as u8;
        let (red, green, blue) = (part(31), part(63), part(31));
        let command = LightCommand { light: LIGHT_ID, red, green, blue };
        self.world.client.broadcast(&Message::LightsCommand(vec![command]));
    }

    // ---- events ----

    fn show(&mut self, happened: Happened) {
        let node_port = self.world.port();
        for (at, fault, begins) in happened.faults {
            self.events.push(mark(at, &format!("{fault}{}", if begins { "" } else { " ends" })));
        }
        self.records.extend(happened.records.iter().map(|(record, _)| *record));
        self.records.drain(..self.records.len().saturating_sub(LOGGED));
        for (record, from) in happened.records {
            let RecordKind::Frame { from: port, .. } = &record.kind else {
                self.show_error(record, from);
                continue;
            };
            let is_node = *port == Some(node_port);
            self.show_frame(record, from.unwrap_or_else(|| String::from("-")), is_node);
        }
        for (output, pulse) in happened.pulses {
            self.pulses[output] = Some((pulse.start, pulse.width_cycles));
        }
        for (output, pulse) in happened.second_pulses {
            if let Some(last) = self.second_pulses.get_mut(output) {
                *last = Some((pulse.start, pulse.width_cycles));
            }
        }
        for (at, line) in happened.lines {
            // Several lines tell of one failsafe.
            if line.contains("over: FAILSAFE") {
                if self.failsafe_at.take().is_some() {
                    self.events.push(mark(at, "commands again"));
                }
            } else if line.contains("FAILSAFE") {
                self.failsafe_at.get_or_insert_with(|| {
                    self.events.push(mark(at, "failsafe"));
                    at
                });
            }
            self.events.push(json!({"kind": "line", "at": seconds(at), "text": line}));
        }
        for (at, text) in happened.mistakes.into_iter().take(20) {
            self.events.push(json!({"kind": "mistake", "at": seconds(at), "text": text}));
        }
        for (at, text) in happened.hints {
            self.events.push(json!({"kind": "hint", "at": seconds(at), "text": text}));
        }
        for (at, text) in self.world.autopilot.take_events() {
            self.events.push(json!({"kind": "node", "at": seconds(at), "text": text}));
        }
        self.transactions.extend(happened.transactions);
        let excess = self.transactions.len().saturating_sub(KEPT);
        self.transactions.drain(..excess);
        for entry in happened.received {
            match entry.fate {
                Fate::Lost => self.lost += 1,
                Fate::Cleared(at) => {
                    self.worst_latency = self.worst_latency.max(at - entry.received_at);
                    // The frame was received before its last bits were over.
                    let received = self.frames.iter_mut().rev().find(|shown| {
                        (shown.record.start..=shown.record.end).contains(&entry.received_at)
                    });
                    if let Some(shown) = received {
                        shown.fetched_at = Some(at);
                    }
                }
            }
        }
    }

    fn show_error(&mut self, record: Record, from: Option<String>) {
        let RecordKind::ErrorFrame { kind, .. } = record.kind else { return };
        let kind = kind.map_or(String::new(), |kind| format!(": {kind:?} error"));
        let text = format!("error frame{}", kind.to_lowercase());
        let described = Described { text, kind: "error", name: None, decoded: None };
        self.push(record, from.unwrap_or_else(|| String::from("-")), described);
    }

    fn show_frame(&mut self, record: Record, from: String, is_node: bool) {
        let RecordKind::Frame { frame, .. } = record.kind else { return };
        let described = describe(&mut self.observer, &frame, elapsed(record.end));
        if is_node && let Some(decoded) = &described.decoded {
            self.take_measurement(record.end, decoded);
        }
        self.push(record, from, described);
    }

    fn push(&mut self, record: Record, from: String, described: Described) {
        let number = self.next_number;
        self.next_number += 1;
        self.events.push(described.event(number, &from, &record));
        let Described { text, .. } = described;
        self.frames.push_back(Shown { number, record, from, text, fetched_at: None });
        if self.frames.len() > KEPT {
            self.frames.pop_front();
        }
    }

    fn take_status(&mut self, at: Cycles, status: NodeStatus) {
        if let Some((last_at, last)) = self.status.replace((at, status)) {
            if last.health != status.health {
                self.events.push(mark(at, &status.health.to_string()));
            }
            // The line that ends a failsafe can be dropped. The first status after it can have
            // waited since before the failsafe, the second can not.
            let is_over = (last.vendor_code | status.vendor_code) & vendor_code::FAILSAFE == 0;
            if is_over && self.failsafe_at.take_if(|begin| *begin <= last_at).is_some() {
                self.events.push(mark(at, "commands again"));
            }
        }
    }

    fn take_measurement(&mut self, at: Cycles, decoded: &Decoded) {
        match decoded {
            Decoded::V0(transfer, Message::NodeStatus(status)) => {
                self.take_status(at, *status);
                if let Some(node) = transfer.id.source() {
                    self.world.client.set_node(node);
                }
            }
            Decoded::Draft(_, draft::Message::NodeStatus(status)) => {
                self.take_status(at, (*status).into());
            }
            Decoded::V0(_, Message::Temperature(temperature)) => {
                self.temperature_c = Some(temperature.celsius().into());
            }
            Decoded::V0(_, Message::ThesisTemperature(degrees)) => {
                self.temperature_c = Some((*degrees).into());
            }
            _ => {}
        }
    }

    /// Removes and returns the events since the last call, a JSON array.
    pub fn take_events(&mut self) -> String {
        Json::Array(std::mem::take(&mut self.events)).to_string()
    }

    // ---- state ----

    /// The state of the world, a JSON object.
    pub fn snapshot(&mut self) -> String {
        let now = self.world.now();
        let autopilot = &self.world.autopilot;
        let deflection = autopilot.deflection(now);
        let autopilot = json!({
            "name": autopilot.settings().profile.to_string(),
            "command_type": autopilot.settings().command_type.to_string(),
            "deflection": deflection,
            "sweeps": autopilot.is_sweeping(),
            "armed": autopilot.is_armed(),
            "safe": autopilot.is_safe(),
        });
        let outputs = self.outputs(now);
        let second = self.second(now);
        let stats = self.world.bench.bus().stats();
        let sensor_c = self.world.temperature_c();
        let active: Vec<_> = self.world.active_faults().iter().map(|fault| fault.name()).collect();
        let controller = self.controller();
        let node = self.node(now);
        let client = self.world.client.dialogue.json();
        let board = self.world.board();
        let crash = findings::crash(board.avr());
        json!({
            "now": seconds(now),
            "autopilot": autopilot,
            "outputs": outputs,
            "second": second,
            "light": board.light(),
            "sensor_c": sensor_c,
            "node_c": self.temperature_c,
            "node": node,
            "controller": controller,
            "client": client,
            "faults": active,
            "load": self.load,
            "frames": stats.frames,
            "error_frames": stats.error_frames,
            "bit_rate": self.world.bench.bus().bit_rate(),
            "crash": crash,
        })
        .to_string()
    }

    /// Index in RawCommand of an output's motor; `None` if the node has not said that it is one.
    fn motor(&self, output: usize) -> Option<u8> {
        let value = |what: &str| {
            let name = format!("OUT{}_{what}", output + 1);
            let mut parameters = self.world.client.dialogue.parameters.iter();
            match parameters.find(|parameter| parameter.name() == name)?.value {
                Value::Integer(number) => u8::try_from(number).ok(),
                _ => None,
            }
        };
        value("ID").filter(|_| value("TYPE") == Some(MOTOR))
    }

    /// Pin, pulse width and command of each output; no width while it gives no pulses. The
    /// autopilot commands its motors.
    fn outputs(&mut self, now: Cycles) -> Json {
        let motors: Vec<_> = (0..self.pulses.len()).map(|output| self.motor(output)).collect();
        let own = motors.iter().flatten().max().map_or(0, |last| last + 1);
        let count = own.max(self.second_pulses.len() as u8);
        if self.world.autopilot.settings().motors != count {
            self.world.autopilot.set_motors(count, now);
        }
        let autopilot = &self.world.autopilot;
        let commands = motors.iter().zip(1..).map(|(motor, id)| match motor {
            Some(index) => autopilot.motor_power(*index, now),
            None => autopilot.deflection_of(id, now),
        });
        let commands: Vec<_> = commands.collect();
        let wiring = self.world.board().wiring();
        let pins = std::iter::once(&wiring.servo).chain(&wiring.outputs);
        let states = self.pulses.iter().zip(motors).zip(commands);
        let outputs = pins.zip(states).map(|(pin, ((pulse, motor), command))| {
            let (pin, width_us) = (pin.to_string(), width_us(pulse, now));
            json!({"pin": pin, "width_us": width_us, "motor": motor, "command": command})
        });
        outputs.collect()
    }

    /// The same of the motors of the second board.
    fn second(&self, now: Cycles) -> Json {
        let autopilot = &self.world.autopilot;
        let motors = (0..).zip(&self.second_pulses).map(|(motor, pulse)| {
            let command = autopilot.motor_power(motor, now);
            let width_us = width_us(pulse, now);
            json!({"pin": "motor", "width_us": width_us, "motor": motor, "command": command})
        });
        motors.collect()
    }

    /// Adds a second board with a program of this project, whose outputs are four motors.
    ///
    /// # Errors
    /// If the program has no motors, or its bus another bit rate.
    pub fn add_second(&mut self, firmware: &Firmware, wiring: &Wiring) -> Result<()> {
        let (bit_rate, own) = (self.world.bench.bus().bit_rate(), wiring.fastest_bit_rate());
        ensure!(
            bit_rate == own,
            "the second board has {} kbit/s, and this bus {}",
            own / 1000,
            bit_rate / 1000
        );
        let powered = || -> Result<Avr> {
            let mut avr = Avr::programmed(wiring.chip, firmware)?;
            avr.seed(1);
            avr.reset(ResetCause::PowerOn);
            Ok(avr)
        };
        let settings = [&[(CAN_NODE, SECOND_NODE)], &FOUR_MOTORS[..]].concat();
        let eeprom = node_ids::saved(powered()?, wiring, bit_rate, &settings)?;
        let mut avr = powered()?;
        avr.set_eeprom(&eeprom.context("the program of the second board has no motors")?);
        self.world.add_second(avr, wiring)?;
        self.second_pulses = vec![None; SECOND_MOTORS.into()];
        Ok(())
    }

    fn controller(&mut self) -> Json {
        let chip = self.world.board().chip();
        let chip = chip.borrow();
        json!({
            "mode": format!("{:?}", chip.mode()),
            "error_state": format!("{:?}", chip.error_state()),
            "tec": chip.tec(),
            "rec": chip.rec(),
            "lost": self.lost,
            "worst_us": micros(self.worst_latency),
        })
    }

    fn node(&self, now: Cycles) -> Json {
        let Some((at, status)) = self.status else { return Json::Null };
        // A text each, and what to do.
        let conditions: Vec<_> = match self.knows_vendor_code {
            true => vendor_code::with_advice(status.vendor_code).collect(),
            false => Vec::new(),
        };
        json!({
            "id": self.world.client.node().get(),
            "silent_s": seconds(now.saturating_sub(at)),
            "health": status.health.to_string(),
            "mode": status.mode.to_string(),
            "uptime_s": status.uptime_s,
            "vendor_code": status.vendor_code,
            "conditions": conditions,
        })
    }

    /// The details of a frame, a JSON object.
    ///
    /// # Errors
    /// If the frame is too old.
    pub fn frame(&self, number: u64) -> Result<String> {
        let shown = self
            .frames
            .iter()
            .find(|shown| shown.number == number)
            .context("the frame is too old")?;
        let bits = match &shown.record.kind {
            RecordKind::Frame { frame, acked, .. } => {
                wire(frame, Ack::seen(*acked), self.world.autopilot.settings().dialect)
            }
            RecordKind::ErrorFrame { .. } => Json::Null,
        };
        let transaction = shown.fetched_at.and_then(|at| {
            self.transactions.iter().rev().find(|t| (t.start..=t.end).contains(&at))
        });
        let spi = transaction.map(|t| {
            json!({
                "name": t.name(),
                "after_us": micros(t.start) - micros(shown.record.end),
                "took_us": micros(t.end - t.start),
                "mosi": t.bytes.iter().map(|byte| byte.0).collect::<Vec<_>>(),
                "miso": t.bytes.iter().map(|byte| byte.1).collect::<Vec<_>>(),
            })
        });
        Ok(json!({
            "number": number,
            "from": shown.from,
            "text": shown.text,
            "time": format!("{:.6} s", seconds(shown.record.start)),
            "count": shown.record.bits,
            "length_us": micros(shown.record.end - shown.record.start),
            "wire": bits,
            "spi": spi,
        })
        .to_string())
    }
}

/// All faults, a JSON array: name, explanation, and whether it lasts until it is ended.
pub fn faults() -> String {
    let faults = ALL.iter().map(
        |fault| json!({"name": fault.name(), "text": fault.explanation(), "lasts": fault.lasts()}),
    );
    faults.collect::<Json>().to_string()
}

/// Names and values of the parameters of four motors, a JSON array.
pub fn four_motors() -> String {
    json!(FOUR_MOTORS).to_string()
}

/// Event that marks a time in the plots and on the time line.
fn mark(at: Cycles, text: &str) -> Json {
    json!({"kind": "mark", "at": seconds(at), "text": text})
}

/// Width of the last pulse in microseconds; `None` if there is none any more.
fn width_us(pulse: &Option<(Cycles, Cycles)>, now: Cycles) -> Option<f64> {
    let (_, width) = pulse.filter(|(start, _)| now.saturating_sub(*start) <= PULSE_TIMEOUT)?;
    Some(micros(width))
}

fn micros(cycles: Cycles) -> f64 {
    cycles as f64 * 1e6 / F_CPU_HZ as f64
}
