//! The simulated world: a board with the node's program, an autopilot, a tool and a further
//! station on one bus.
//!
//! It is the same with simavr and with avr8js. The cross-check compares the two, and the web page
//! shows the second.

use std::cell::RefCell;
use std::rc::Rc;

use anyhow::Result;
use bench::autopilot::{Autopilot, Settings};
use bench::avr::{Firmware, Processor, Pulse, SerialCharacter};
use bench::board::{Board, WireEvent};
use bench::can::{PortId, Record, SoftNode};
use bench::dronecan::NodeId;
use bench::fault::Fault;
use bench::inject::{Injector, Target};
use bench::mcp2515::LoggedFrame;
use bench::wiring::Wiring;
use bench::{Bench, Cycles, F_CPU_HZ};

use crate::client::Client;
use crate::spi::{Transaction, Transactions};

/// Longest simulated time between two calls of the stations.
const SLICE: Cycles = F_CPU_HZ / 1000;
/// Longest line of the serial monitor. A longer one is cut.
const LINE_MAX: usize = 200;
/// Node ID of the program before it is known otherwise.
pub const DEFAULT_NODE: u8 = 120;

/// What happened since the last call of [`World::take`].
#[derive(Debug, Default)]
pub struct Happened {
    /// Frames and error frames, with the names of their senders.
    pub records: Vec<(Record, Option<String>)>,
    /// Pulses that ended, and the index of their output: 0 is the servo on Timer1.
    pub pulses: Vec<(usize, Pulse)>,
    /// Lines of the serial monitor, and the times of their ends.
    pub lines: Vec<(Cycles, String)>,
    pub transactions: Vec<Transaction>,
    /// Frames that the controller received, and when the driver fetched them.
    pub received: Vec<LoggedFrame>,
    /// The program's mistakes.
    pub mistakes: Vec<(Cycles, String)>,
}

/// A bench with one board and the stations that talk to it.
pub struct World<P> {
    pub bench: Bench<P>,
    node: usize,
    pub autopilot: Autopilot,
    autopilot_port: PortId,
    pub client: Client,
    injector: Injector,
    sensor_c: f64,
    line: String,
    transactions: Transactions,
    happened: Happened,
}

impl<P: Processor> World<P> {
    /// A board that is powered at time 0 on a bus of its default bit rate.
    ///
    /// # Errors
    /// If the wiring in the program is impossible.
    pub fn new(processor: P, firmware: &Firmware, settings: Settings) -> Result<World<P>> {
        let wiring = Wiring::of_program(firmware)?;
        let bit_rate = wiring.fastest_bit_rate();
        let mut bench = Bench::of_processor(bit_rate);
        let node = bench.add_board(Board::wired(processor, &wiring)?, "node");
        let autopilot = Autopilot::new(settings, bit_rate);
        let autopilot_port = bench.attach("autopilot", autopilot.station());
        let client = Client::new(NodeId::new(DEFAULT_NODE).expect("a node ID"), bit_rate);
        bench.attach("tool", client.station());
        let injector = Injector::new(&mut bench);
        bench.board(node).attach_probe();
        Ok(World {
            bench,
            node,
            autopilot,
            autopilot_port,
            client,
            injector,
            sensor_c: 20.0,
            line: String::new(),
            transactions: Transactions::default(),
            happened: Happened::default(),
        })
    }

    /// The node's board.
    pub fn board(&mut self) -> &mut Board<P> {
        self.bench.board(self.node)
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
        self.injector.inject(fault, &mut target);
        if fault == Fault::OtherDialect {
            let old = self.autopilot.settings().clone();
            let dialect = old.dialect.other();
            self.replace_autopilot(old.in_dialect(dialect));
        }
    }

    /// Replaces the autopilot by one with other settings, at its power-on.
    pub fn replace_autopilot(&mut self, settings: Settings) {
        let (bit_rate, now) = (self.bench.bus().bit_rate(), self.now());
        let successor = self.autopilot.successor(settings, bit_rate, now);
        let port = self.bench.attach("autopilot", successor.station());
        std::mem::replace(&mut self.autopilot, successor).switch_off();
        let old = std::mem::replace(&mut self.autopilot_port, port);
        self.bench.detach(old);
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
            let next = until.min(self.now() + SLICE);
            self.autopilot.advance(next);
            self.client.serve(self.now());
            self.bench.run_until(next);
            self.collect();
        }
    }

    /// Removes and returns what happened since the last call.
    pub fn take(&mut self) -> Happened {
        std::mem::take(&mut self.happened)
    }

    fn collect(&mut self) {
        for record in self.bench.bus().take_records() {
            use bench::can::RecordKind::{ErrorFrame, Frame};
            let (Frame { from, .. } | ErrorFrame { from, .. }) = record.kind;
            let from = from.map(|port| self.bench.bus().name(port).to_owned());
            self.happened.records.push((record, from));
        }
        self.injector.babbler().borrow_mut().take_received();
        let board = self.bench.board(self.node);
        let servo = board.take_servo_pulses().into_iter().map(|pulse| (0, pulse));
        let outputs = board.take_output_pulses().into_iter().enumerate();
        let outputs =
            outputs.flat_map(|(at, pulses)| pulses.into_iter().map(move |pulse| (at + 1, pulse)));
        self.happened.pulses.extend(servo.chain(outputs));
        let mistakes = board.take_violations().into_iter();
        self.happened.mistakes.extend(
            mistakes.map(|mistake| (mistake.at, format!("{}: {}", mistake.source, mistake.text))),
        );
        self.happened.received.extend(board.chip().borrow_mut().take_frame_log());
        for (at, event) in board.take_wire_events() {
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

    /// Adds a character to the line of the serial monitor.
    fn take_character(&mut self, character: SerialCharacter) {
        // Eight data bits after the start bit. 0 bits: a reset cut the character off.
        if character.bits == 0 {
            return;
        }
        let byte = (character.levels >> 1) as u8;
        match byte {
            b'\r' => return,
            b'\n' => {}
            b' '..=b'~' => self.line.push(char::from(byte)),
            _ => self.line.push_str(&format!("\\x{byte:02x}")),
        }
        if byte == b'\n' || self.line.len() >= LINE_MAX {
            let end = character.start + u64::from(character.bits) * character.cycles_per_bit;
            self.happened.lines.push((end, std::mem::take(&mut self.line)));
        }
    }
}
