//! The simulated world: a board with the node's program, an autopilot, a tool and a further
//! station on one bus.
//!
//! The web page shows it; the cross-check compares it with itself on simavr.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use anyhow::Result;
use bench::autopilot::{Autopilot, Settings};
use bench::avr::{Avr, Pulse, SerialCharacter};
use bench::board::{Board, WireEvent};
use bench::can::{Level, PortId, Record, SoftNode};
use bench::dronecan::NodeId;
use bench::fault::Fault;
use bench::findings::{Findings, Said};
use bench::i2c;
use bench::inject::{Injector, Target};
use bench::mcp2515::LoggedFrame;
use bench::script::{Action, BenchEvent};
use bench::serial_line::SerialLine;
use bench::slcan::{Port, Slcan};
use bench::vcd::{self, Drawn, Wire, Writer};
use bench::wiring::Wiring;
use bench::{Bench, Cycles, F_CPU_HZ};

use crate::client::Client;
use crate::spi::{Transaction, Transactions};

/// Longest simulated time between two calls of the stations.
const SLICE: Cycles = F_CPU_HZ / 1000;
/// Bytes that wait for the client of the adapter.
const OUTPUT_MAX: usize = 64 * 1024;
/// Node ID of the program before it is known otherwise.
pub const DEFAULT_NODE: u8 = 120;

/// What happened since the last call of [`World::take`].
#[derive(Debug, Default)]
pub struct Happened {
    /// Frames and error frames, with the names of their senders.
    pub records: Vec<(Record, Option<String>)>,
    /// Pulses that ended, and the index of their output: 0 is the servo on Timer1.
    pub pulses: Vec<(usize, Pulse)>,
    /// The same of the second board.
    pub second_pulses: Vec<(usize, Pulse)>,
    /// Lines of the serial monitor, and the times of their ends.
    pub lines: Vec<(Cycles, String)>,
    pub transactions: Vec<Transaction>,
    /// Frames that the controller received, and when the driver fetched them.
    pub received: Vec<LoggedFrame>,
    /// The program's mistakes.
    pub mistakes: Vec<(Cycles, String)>,
    /// What the author of the program is told besides.
    pub hints: Vec<(Cycles, String)>,
    /// Faults that began or happened (true), or ended.
    pub faults: Vec<(Cycles, Fault, bool)>,
}

/// The port of the adapter on the simulated bus.
#[derive(Default)]
pub struct Buffers {
    /// Bytes of the client, and for it.
    pub input: Vec<u8>,
    pub output: Vec<u8>,
}

impl Port for Buffers {
    fn name(&self) -> String {
        "of this page".to_owned()
    }

    fn read(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.input)
    }

    fn write(&mut self, bytes: &[u8]) -> usize {
        let taken = bytes.len().min(OUTPUT_MAX.saturating_sub(self.output.len()));
        self.output.extend(&bytes[..taken]);
        taken
    }

    fn discard_unread(&mut self) {
        self.output.clear();
    }
}

/// A recording of the wires as VCD.
struct Recording {
    writer: Writer<Vec<u8>>,
    drawn: Drawn,
    /// Changes of the bus.
    bus: Rc<RefCell<Vec<(Cycles, Level)>>>,
}

/// A bench with one board and the stations that talk to it.
pub struct World {
    pub bench: Bench,
    node: usize,
    /// Number of the second board, if there is one.
    second: Option<usize>,
    pub autopilot: Autopilot,
    autopilot_port: PortId,
    pub client: Client,
    injector: Injector,
    sensor_c: f64,
    /// Millivolts at the inputs that measure a circuit: voltage and current.
    circuit_mv: [u32; 2],
    /// The devices on the two-wire bus of the board.
    i2c: i2c::Devices,
    /// Events of scripts that are not due yet, in order.
    script: VecDeque<(Cycles, BenchEvent)>,
    /// Stations that send the frames of scripts.
    script_stations: Vec<Rc<RefCell<SoftNode>>>,
    /// `None` until the view of the real bus asks for it.
    adapter: Option<Slcan<Buffers>>,
    recording: Option<Recording>,
    /// `None` if nobody asked for hints.
    findings: Option<Findings>,
    line: SerialLine,
    transactions: Transactions,
    happened: Happened,
}

impl World {
    /// A board that is powered at time 0 on a bus.
    ///
    /// # Errors
    /// If the wiring is impossible.
    pub fn new(mut avr: Avr, wiring: &Wiring, bit_rate: u32, settings: Settings) -> Result<World> {
        let i2c = i2c::Devices::default();
        avr.connect_twi(Box::new(i2c.clone()));
        let mut bench = Bench::new(bit_rate);
        let node = bench.add_board(Board::wired(avr, wiring)?, "node");
        let autopilot = Autopilot::new(settings, bit_rate);
        let autopilot_port = bench.attach("autopilot", autopilot.station());
        let client = Client::new(NodeId::new(DEFAULT_NODE).expect("a node ID"), bit_rate);
        bench.attach("tool", client.station());
        let injector = Injector::new(&mut bench);
        bench.board(node).attach_probe();
        Ok(World {
            bench,
            node,
            second: None,
            autopilot,
            autopilot_port,
            client,
            injector,
            sensor_c: 20.0,
            circuit_mv: [0; 2],
            i2c,
            script: VecDeque::new(),
            script_stations: Vec::new(),
            adapter: None,
            recording: None,
            findings: None,
            line: SerialLine::default(),
            transactions: Transactions::default(),
            happened: Happened::default(),
        })
    }

    /// Gives hints to the author of the program from now on.
    pub fn give_hints(&mut self) {
        let mut findings = Findings::default();
        findings.watch_selects(self.board());
        self.findings = Some(findings);
    }

    /// The node's board.
    pub fn board(&mut self) -> &mut Board {
        self.bench.board(self.node)
    }

    /// Adds a second board to the bus.
    ///
    /// # Errors
    /// If the wiring is impossible.
    pub fn add_second(&mut self, avr: Avr, wiring: &Wiring) -> Result<()> {
        self.second = Some(self.bench.add_board(Board::wired(avr, wiring)?, "second node"));
        Ok(())
    }

    /// The node's port on the bus.
    pub fn port(&self) -> PortId {
        self.bench.port(self.node)
    }

    /// A further station, which acknowledges all frames and sends what it is told.
    pub fn other(&self) -> &Rc<RefCell<SoftNode>> {
        self.injector.babbler()
    }

    /// The lasting faults that are on.
    pub fn active_faults(&self) -> &[Fault] {
        self.injector.active()
    }

    /// Begins a fault; ends it if it lasts and is on. `OtherDialect` replaces the autopilot.
    pub fn inject(&mut self, fault: Fault) {
        let mut target = Target {
            bench: &mut self.bench,
            node: self.node,
            autopilot: Some(&mut self.autopilot),
            node_id: self.client.node().get(),
            sensor_c: self.sensor_c,
        };
        let lasts = self.injector.inject(fault, &mut target);
        let begins = lasts || !fault.lasts();
        self.happened.faults.push((self.bench.now(), fault, begins));
        if fault == Fault::OtherDialect {
            let old = self.autopilot.settings().clone();
            let dialect = old.dialect.other();
            self.replace_autopilot(old.in_dialect(dialect));
        }
    }

    /// Replaces the autopilot by one with other settings, at its power-on.
    pub fn replace_autopilot(&mut self, settings: Settings) {
        self.autopilot.replace(settings, &mut self.bench, &mut self.autopilot_port);
    }

    /// Sets the temperature at the sensor in degrees Celsius.
    pub fn set_temperature_c(&mut self, celsius: f64) {
        self.sensor_c = celsius;
        self.board().set_temperature_c(celsius);
    }

    /// Temperature at the sensor in degrees Celsius.
    pub fn temperature_c(&self) -> f64 {
        self.sensor_c
    }

    /// Simulated time.
    pub fn now(&self) -> Cycles {
        self.bench.now()
    }

    /// Simulates until `until`.
    pub fn advance(&mut self, until: Cycles) {
        while self.now() < until {
            while let Some((_, event)) = self.script.pop_front_if(|(at, _)| *at <= self.bench.now())
            {
                self.apply(event);
            }
            let event_at = self.script.front().map_or(until, |(at, _)| *at);
            let next = until.min(self.now() + SLICE).min(event_at);
            self.autopilot.advance(next);
            self.client.serve(self.now());
            self.bench.run_until(next);
            if let Some(adapter) = &mut self.adapter {
                adapter.serve(&self.bench);
            }
            self.collect();
        }
    }

    /// The port of an SLCAN adapter on the bus, whose channel is closed at first.
    pub fn adapter(&mut self) -> &mut Buffers {
        let bench = &mut self.bench;
        self.adapter
            .get_or_insert_with(|| Slcan::attach(Buffers::default(), "adapter", bench))
            .port()
    }

    /// Plays the lines of a script, whose times count from power-on. Returns the number of frames
    /// and of events.
    pub fn play(&mut self, lines: Vec<(Cycles, Action)>) -> (usize, usize) {
        let station = Rc::new(RefCell::new(SoftNode::new(self.bench.bus().bit_rate())));
        self.bench.attach("script", station.clone());
        let mut frames = 0;
        for (at, action) in lines {
            match action {
                Action::Send(frame) => {
                    frames += 1;
                    station.borrow_mut().send_at(at, frame);
                }
                Action::Do(event) => self.script.push_back((at, event)),
                Action::Skip => {}
            }
        }
        self.script_stations.push(station);
        (frames, self.script.len())
    }

    fn apply(&mut self, event: BenchEvent) {
        match event {
            BenchEvent::Temperature(celsius) => self.set_temperature_c(celsius),
            BenchEvent::CircuitVoltage(millivolts) => self.circuit_mv[0] = millivolts,
            BenchEvent::CircuitCurrent(millivolts) => self.circuit_mv[1] = millivolts,
            BenchEvent::Button(pressed) => self.board().press_button(pressed),
            BenchEvent::Fault(fault) => self.inject(fault),
            BenchEvent::Serial(bytes) => self.board().avr_mut().serial_send(&bytes),
            BenchEvent::I2c(setting) => self.i2c.set(&setting),
            BenchEvent::Shaft(rpm) => self.board().set_shaft_rpm(rpm),
            BenchEvent::Set(setting) => match setting.check(self.board().wiring()) {
                Ok(()) => setting.apply(self.board()),
                Err(error) => {
                    self.happened.mistakes.push((self.bench.now(), format!("not set: {error}")));
                }
            },
        }
        let [voltage, current] = self.circuit_mv;
        self.board().set_circuit_millivolts(voltage, current);
    }

    /// Begins to record the wires of the board and the bus.
    pub fn record_wires(&mut self) {
        let now = self.now();
        let probe = self.board().attach_probe();
        let levels = vcd::levels(self.bench.bus().level(), &probe);
        let named = vcd::wires(&[], self.board().wiring().outputs.len(), &[]);
        let writer = Writer::new(Vec::new(), now, &named, levels).expect("memory takes all");
        let bus = Rc::default();
        let tap: Rc<RefCell<Vec<_>>> = Rc::clone(&bus);
        let tap = move |at, level| tap.borrow_mut().push((at, level));
        self.bench.bus().set_wire_tap(Some(Box::new(tap)));
        self.recording = Some(Recording { writer, drawn: Drawn::new(now), bus });
    }

    /// Ends the recording. Returns the VCD file, which is empty if there was no recording.
    pub fn take_wires(&mut self) -> Vec<u8> {
        let Some(Recording { mut writer, bus, .. }) = self.recording.take() else {
            return Vec::new();
        };
        self.bench.bus().set_wire_tap(None);
        for (at, level) in bus.take() {
            writer.change(at, Wire::Can, !level.is_dominant());
        }
        writer.finish(self.now()).expect("memory takes all");
        writer.into_inner()
    }

    /// Removes and returns what happened since the last call.
    pub fn take(&mut self) -> Happened {
        std::mem::take(&mut self.happened)
    }

    fn collect(&mut self) {
        self.collect_from_second();
        let records = self.bench.take_records().into_iter();
        let named = records.map(|(record, from)| (record, from.map(|(_, name)| name)));
        self.happened.records.extend(named);
        for station in self.script_stations.iter().chain([self.injector.babbler()]) {
            station.borrow_mut().take_received();
        }
        let (now, bit_rate) = (self.bench.now(), self.bench.bus().bit_rate());
        let board = self.bench.board(self.node);
        if let Some(findings) = &mut self.findings {
            let hints = findings.check(board, bit_rate).into_iter();
            self.happened.hints.extend(hints.map(|hint| (now, hint)));
        }
        take_pulses(board, &mut self.happened.pulses);
        let mistakes = board.take_violations().into_iter();
        self.happened.mistakes.extend(mistakes.map(|mistake| (mistake.at, mistake.to_string())));
        self.happened.received.extend(board.chip().borrow_mut().take_frame_log());
        for (at, event) in board.take_wire_events() {
            if let Some(Recording { writer, drawn, .. }) = &mut self.recording {
                drawn.draw(writer, at, event);
            }
            match event {
                WireEvent::Cs(level) => {
                    self.happened.transactions.extend(self.transactions.chip_select(at, level));
                }
                WireEvent::Spi { byte, miso } => self.transactions.byte(byte.mosi, miso),
                WireEvent::Serial(character) if !character.to_chip => {
                    self.take_character(character)
                }
                _ => {}
            }
        }
    }

    /// What the second board did. Its serial monitor is not shown.
    fn collect_from_second(&mut self) {
        let Some(second) = self.second else { return };
        let board = self.bench.board(second);
        take_pulses(board, &mut self.happened.second_pulses);
        for mistake in board.take_violations() {
            self.happened.mistakes.push((mistake.at, format!("second node: {mistake}")));
        }
        board.avr_mut().serial_take();
        board.chip().borrow_mut().take_frame_log();
    }

    /// Adds a character to the line of the serial monitor.
    fn take_character(&mut self, character: SerialCharacter) {
        // Eight data bits after the start bit. 0 bits: a reset cut the character off.
        if character.bits == 0 {
            return;
        }
        let rate = F_CPU_HZ / character.cycles_per_bit;
        let said = self.findings.as_mut().and_then(|findings| findings.check_serial_rate(rate));
        if let Some(Said::Hint(text) | Said::Note(text)) = said {
            self.happened.hints.push((character.start, text));
        }
        let byte = (character.levels >> 1) as u8;
        let end = character.start + u64::from(character.bits) * character.cycles_per_bit;
        let line = self.line.push(character.start, byte);
        self.happened.lines.extend(line.map(|(_, text)| (end, text)));
    }
}

/// Adds the pulses of each output: 0 is the servo on Timer1.
fn take_pulses(board: &mut Board, pulses: &mut Vec<(usize, Pulse)>) {
    pulses.extend(board.take_servo_pulses().into_iter().map(|pulse| (0, pulse)));
    for (output, taken) in board.take_output_pulses().into_iter().enumerate() {
        pulses.extend(taken.into_iter().map(|pulse| (output + 1, pulse)));
    }
}
