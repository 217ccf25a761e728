//! The test stand: a firmware with a third-party driver on a board, a peer that sends to it, and a
//! recorder on its SPI.
//!
//! This file repeats the constants of the firmwares (`tests/third-party/src/job.rs`) on purpose, so
//! that an error there shows.

use bench::Cycles;
use bench::avr::{Chip, SpiByte, SpiDevice};
use bench::board::Board;
use bench::can::{Fault, Frame, Id, SoftNode};
use bench::mcp2515::{LoggedFrame, Mcp2515};
use bench::wiring::{Pin, Wiring};
use bench::{Bench, target_dir};
use std::cell::RefCell;
use std::path::PathBuf;
use std::rc::Rc;

/// Identifier of the frames that the firmware sends periodically.
pub const COUNTER_ID: Id = Id::Extended(0x18C0_FFEE);
/// Time in which the firmware answers and reports three frames; one frame takes 3.3 ms.
pub const SERVED_MS: u64 = 12;

const BOOT_LIMIT_MS: u64 = 50;
const CYCLES_PER_MS: u64 = 16_000;

/// A firmware with a third-party driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ThirdParty {
    /// With the crate `mcp2515` 0.3.
    Mcp2515,
    /// With the crate `mcp25xx` 0.4.
    Mcp25xx,
    /// With the crate `mcp25xx` 0.4 and its feature `mcp2515`.
    Mcp25xxWrongRxb1,
}

/// A CAN board for which the firmwares are built.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CanBoard {
    /// CS on D9, 16 MHz, 1 Mbit/s.
    Shield,
    /// CS on D10, 8 MHz, 500 kbit/s.
    Module,
}

/// The chip and the CAN board on which a firmware runs.
pub type Place = (Chip, CanBoard);

/// The place in which every test runs. Some tests also run in the other places.
pub const DEFAULT: Place = (Chip::Atmega168, CanBoard::Shield);
pub const PLACES: [Place; 4] = [
    DEFAULT,
    (Chip::Atmega168, CanBoard::Module),
    (Chip::Atmega328p, CanBoard::Shield),
    (Chip::Atmega328p, CanBoard::Module),
];

fn wiring((chip, can_board): Place) -> Wiring {
    let board = match chip {
        Chip::Atmega168 => "diecimila",
        Chip::Atmega328p => "uno",
    };
    let shield = match can_board {
        CanBoard::Shield => "seeed",
        CanBoard::Module => "module",
    };
    Wiring::of(board, shield).expect("boards of the table")
}

impl ThirdParty {
    fn elf(self, (chip, can_board): Place) -> PathBuf {
        let name = match self {
            ThirdParty::Mcp2515 => "third-party-mcp2515-crate",
            ThirdParty::Mcp25xx => "third-party-mcp25xx-crate",
            ThirdParty::Mcp25xxWrongRxb1 => "third-party-mcp25xx-wrong-rxb1",
        };
        let suffix = match can_board {
            CanBoard::Shield => "",
            CanBoard::Module => "-module",
        };
        let path = target_dir().join(format!("avr-{}/firmware/{name}{suffix}.elf", chip.name()));
        assert!(path.exists(), "{} is missing: run `make third-party`", path.display());
        path
    }
}

/// A line that the firmware sends on its serial port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Report {
    Configured,
    /// A frame that the crate returned, and the CPU cycles of its call.
    Received(Frame, u64),
    /// The crate returned an error for a received frame.
    Rejected,
    /// The crate returned an error for a frame to send.
    NotSent,
}

impl Report {
    fn parse(line: &str) -> Report {
        let words: Vec<&str> = line.split(' ').collect();
        match words[..] {
            ["I"] => Report::Configured,
            ["E"] => Report::Rejected,
            ["X"] => Report::NotSent,
            ["R", cycles, frame] => {
                let cycles = u64::from_str_radix(cycles, 16).expect("hexadecimal cycles");
                Report::Received(frame.parse().expect("a frame"), cycles)
            }
            _ => panic!("not a report: {line:?}"),
        }
    }
}

/// One instruction on the SPI, from chip select low to high.
#[derive(Debug, Clone, Default)]
pub struct Instruction {
    pub start: Cycles,
    pub end: Cycles,
    pub mosi: Vec<u8>,
    pub miso: Vec<u8>,
}

/// A firmware on a board, with a peer on its bus.
pub struct Stand {
    firmware: ThirdParty,
    bench: Bench,
    peer: Rc<RefCell<SoftNode>>,
    chip: Rc<RefCell<Mcp2515>>,
    instructions: Rc<RefCell<Vec<Instruction>>>,
    serial: Vec<u8>,
    reports: Vec<Report>,
    received: Vec<(Cycles, Frame)>,
}

impl Stand {
    /// The firmware on the default board, booted until its chip is on the bus.
    #[track_caller]
    pub fn new(firmware: ThirdParty) -> Stand {
        Stand::at(DEFAULT, firmware)
    }

    /// The firmware on a board, booted until its chip is on the bus. The bus has the highest bit
    /// rate of the board.
    #[track_caller]
    pub fn at(place: Place, firmware: ThirdParty) -> Stand {
        let wiring = wiring(place);
        let bit_rate = wiring.fastest_bit_rate();
        let board = Board::load_as(&firmware.elf(place), &wiring).expect("a firmware for the chip");
        let chip = board.chip();
        let mut bench = Bench::new(bit_rate);
        let index = bench.add_board(board, "third-party");
        let peer = Rc::new(RefCell::new(SoftNode::new(bit_rate)));
        bench.attach("peer", peer.clone());
        let instructions = record_spi(bench.board(index), &chip, wiring.cs);
        let mut stand = Stand {
            firmware,
            bench,
            peer,
            chip,
            instructions,
            serial: Vec::new(),
            reports: Vec::new(),
            received: Vec::new(),
        };
        let mut waited_ms = 0;
        while stand.take_reports() != [Report::Configured] {
            waited_ms += 1;
            assert!(waited_ms <= BOOT_LIMIT_MS, "{firmware:?} does not boot");
            stand.run_ms(1);
        }
        stand
    }

    pub fn run_ms(&mut self, milliseconds: u64) {
        self.bench.run_for_ms(milliseconds);
        self.collect();
    }

    pub fn run_us(&mut self, microseconds: u64) {
        self.bench.run_for_us(microseconds);
        self.collect();
    }

    /// Lets the peer send frames, back to back.
    pub fn send(&mut self, frames: &[Frame]) {
        for &frame in frames {
            self.peer.borrow_mut().send(frame);
        }
    }

    /// Sends one frame, and waits until the firmware has answered and reported it.
    pub fn serve(&mut self, frame: Frame) {
        self.send(&[frame]);
        self.run_ms(SERVED_MS);
    }

    /// Sends a frame, and then the others while the firmware still reports the first and does not
    /// poll the chip.
    pub fn serve_while_busy(&mut self, first: Frame, others: &[Frame]) {
        self.send(&[first]);
        self.run_us(1_000);
        self.send(others);
        self.run_ms(SERVED_MS);
    }

    /// Sends a frame, and inverts one bit in the first attempt of the answer.
    pub fn serve_with_error_in_answer(&mut self, frame: Frame, bit: u32) {
        self.send(&[frame]);
        // The frame has begun, so the next frame is the answer.
        self.run_us(50);
        self.flip_bit(bit);
        self.run_ms(SERVED_MS);
    }

    /// Inverts one bit of the next frame, for all stations.
    pub fn flip_bit(&mut self, bit: u32) {
        self.bench.bus().inject(Fault::FlipBit { bit });
    }

    /// Removes and returns the firmware's reports since the last call.
    pub fn take_reports(&mut self) -> Vec<Report> {
        std::mem::take(&mut self.reports)
    }

    /// Removes and returns the frames in the firmware's reports since the last call. Panics at
    /// another report.
    #[track_caller]
    pub fn take_frames_reported(&mut self) -> Vec<Frame> {
        let firmware = self.firmware;
        let frame = |report| match report {
            Report::Received(frame, _) => frame,
            other => panic!("{firmware:?} reports {other:?}"),
        };
        self.take_reports().into_iter().map(frame).collect()
    }

    /// Removes and returns the answers that the peer received since the last call.
    pub fn take_answers(&mut self) -> Vec<Frame> {
        let received = std::mem::take(&mut self.received);
        let frames = received.into_iter().map(|(_, frame)| frame);
        frames.filter(|frame| frame.id != COUNTER_ID).collect()
    }

    /// Removes and returns the counter frames that the peer received since the last call, with
    /// their times.
    pub fn take_counters(&mut self) -> Vec<(Cycles, Frame)> {
        let received = std::mem::take(&mut self.received);
        received.into_iter().filter(|(_, frame)| frame.id == COUNTER_ID).collect()
    }

    /// Removes and returns the frames that passed the chip's filters and were read or lost since
    /// the last call.
    pub fn take_frame_log(&mut self) -> Vec<LoggedFrame> {
        self.chip.borrow_mut().take_frame_log()
    }

    /// Removes and returns the SPI instructions since the last call.
    pub fn take_instructions(&mut self) -> Vec<Instruction> {
        self.instructions.take()
    }

    /// Value of a register of the MCP2515.
    pub fn register(&self, address: u8) -> u8 {
        self.chip.borrow().register(address)
    }

    pub fn sample_point_permille(&self) -> u32 {
        self.chip.borrow().sample_point_permille()
    }

    pub fn frames_lost(&self) -> u32 {
        self.chip.borrow().rx_overflows()
    }

    /// Removes and returns the violations that the AVR, the MCP2515 and the board reported since
    /// the last call.
    pub fn take_violations(&mut self) -> Vec<String> {
        let violations = self.bench.board(0).take_violations().into_iter();
        violations.map(|violation| violation.to_string()).collect()
    }

    /// Ends a test. Fails if the driver did something that the datasheet forbids.
    #[track_caller]
    pub fn assert_no_violations(mut self) {
        assert_eq!(self.take_violations(), Vec::<String>::new(), "{:?}", self.firmware);
    }

    fn collect(&mut self) {
        let bytes = self.bench.board(0).avr_mut().serial_take();
        for (_, byte) in bytes {
            if byte != b'\n' {
                self.serial.push(byte);
                continue;
            }
            let line = String::from_utf8(std::mem::take(&mut self.serial)).expect("ASCII");
            self.reports.push(Report::parse(&line));
        }
        self.received.extend(self.peer.borrow_mut().take_received());
    }
}

/// The frame with which the firmware answers `frame`.
pub fn answer_to(frame: &Frame) -> Frame {
    let id = match frame.id {
        Id::Standard(id) => Id::Standard(id + 1),
        Id::Extended(id) => Id::Extended(id + 1),
    };
    if frame.remote {
        return Frame::remote(id, frame.dlc);
    }
    let mut data = [0; 8];
    for (to, from) in data.iter_mut().zip(frame.data()) {
        *to = !from;
    }
    Frame::with_dlc(id, frame.data().len() as u8, data)
}

pub fn milliseconds(cycles: Cycles) -> u64 {
    cycles / CYCLES_PER_MS
}

/// The MCP2515, with a recorder of the bytes on its SPI.
struct Recorder {
    chip: Rc<RefCell<Mcp2515>>,
    current: Rc<RefCell<Instruction>>,
}

impl SpiDevice for Recorder {
    fn begin_byte(&mut self, at: Cycles) {
        self.chip.borrow_mut().begin_byte(at);
    }

    fn end_byte(&mut self, byte: &SpiByte) -> u8 {
        let miso = self.chip.borrow_mut().end_byte(byte.mosi, byte.end);
        let mut current = self.current.borrow_mut();
        current.mosi.push(byte.mosi);
        current.miso.push(miso);
        miso
    }
}

/// Records all instructions on the SPI between the AVR and the chip.
fn record_spi(
    board: &mut Board,
    chip: &Rc<RefCell<Mcp2515>>,
    cs: Pin,
) -> Rc<RefCell<Vec<Instruction>>> {
    let instructions = Rc::new(RefCell::new(Vec::new()));
    let current = Rc::new(RefCell::new(Instruction::default()));
    board
        .avr_mut()
        .connect_spi(Box::new(Recorder { chip: chip.clone(), current: current.clone() }));
    let finished = instructions.clone();
    board.avr_mut().watch_pin(
        cs.port(),
        cs.bit(),
        Box::new(move |level, at| {
            let mut current = current.borrow_mut();
            if level {
                current.end = at;
                finished.borrow_mut().push(std::mem::take(&mut *current));
            } else {
                current.start = at;
            }
        }),
    );
    instructions
}
