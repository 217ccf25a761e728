//! The test stand: a firmware with a third-party driver on a board, a peer that sends to it, and a spy on its SPI.
//!
//! The numbers of the firmwares' job (`third-party/job.rs`) are restated here.

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

/// Identifier of the frames that the firmware sends on its own.
pub const COUNTER_ID: Id = Id::Extended(0x18C0_FFEE);
/// Longer than the firmware takes to answer and report one frame (3.3 ms), with a frame in each buffer before it.
pub const SERVED_MS: u64 = 12;

const BOOT_LIMIT_MS: u64 = 50;
const CYCLES_PER_MS: u64 = 16_000;

/// The firmwares.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ThirdParty {
    /// On `mcp2515` 0.3.
    Mcp2515,
    /// On `mcp25xx` 0.4.
    Mcp25xx,
    /// On `mcp25xx` 0.4 with its feature `mcp2515`.
    Mcp25xxWrongRxb1,
}

/// The CAN boards that the firmwares are built for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CanBoard {
    /// CS on D9, 16 MHz, 1 Mbit/s.
    Shield,
    /// CS on D10, 8 MHz, 500 kbit/s.
    Module,
}

/// What a firmware runs on.
pub type Place = (Chip, CanBoard);

/// Where every test runs; a smaller set runs in the other places.
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
        let path = target_dir().join(format!("avr-{}/release/{name}{suffix}.elf", chip.name()));
        assert!(path.exists(), "{} is missing: run `make third-party`", path.display());
        path
    }
}

/// What the firmware says on its serial port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Report {
    Configured,
    /// A frame, as the crate gave it, and the CPU cycles that this took.
    Received(Frame, u64),
    /// The crate refused what it found in the chip.
    Refused,
    /// The crate did not take a frame to send.
    NotSent,
}

impl Report {
    fn parse(line: &str) -> Report {
        let words: Vec<&str> = line.split(' ').collect();
        match words[..] {
            ["I"] => Report::Configured,
            ["E"] => Report::Refused,
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

pub struct Stand {
    firmware: ThirdParty,
    bench: Bench,
    peer: Rc<RefCell<SoftNode>>,
    chip: Rc<RefCell<Mcp2515>>,
    instructions: Rc<RefCell<Vec<Instruction>>>,
    serial: Vec<u8>,
    reports: Vec<Report>,
    heard: Vec<(Cycles, Frame)>,
}

impl Stand {
    /// The firmware on the default board, booted until its chip is on the bus.
    #[track_caller]
    pub fn new(firmware: ThirdParty) -> Stand {
        Stand::at(DEFAULT, firmware)
    }

    /// The same on another board, on a bus of the highest bit rate that it can do.
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
        let instructions = spy(bench.board(index), &chip, wiring.cs);
        let mut stand = Stand {
            firmware,
            bench,
            peer,
            chip,
            instructions,
            serial: Vec::new(),
            reports: Vec::new(),
            heard: Vec::new(),
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

    /// Sends one frame and waits until it is served.
    pub fn serve(&mut self, frame: Frame) {
        self.send(&[frame]);
        self.run_ms(SERVED_MS);
    }

    /// Sends a frame, and the others while the firmware still reports the first and does not poll the chip.
    pub fn serve_while_busy(&mut self, first: Frame, others: &[Frame]) {
        self.send(&[first]);
        self.run_us(1_000);
        self.send(others);
        self.run_ms(SERVED_MS);
    }

    /// Sends a frame, and inverts one bit of the answer's first attempt.
    pub fn serve_with_error_in_answer(&mut self, frame: Frame, bit: u32) {
        self.send(&[frame]);
        // The frame's SOF is past: the next frame is the answer.
        self.run_us(50);
        self.flip_bit(bit);
        self.run_ms(SERVED_MS);
    }

    /// Inverts one bit of the next frame, for everybody.
    pub fn flip_bit(&mut self, bit: u32) {
        self.bench.bus().inject(Fault::FlipBit { bit });
    }

    /// The firmware's reports since the last call.
    pub fn take_reports(&mut self) -> Vec<Report> {
        std::mem::take(&mut self.reports)
    }

    /// The frames in the firmware's reports since the last call; there must be no other reports.
    #[track_caller]
    pub fn take_frames_reported(&mut self) -> Vec<Frame> {
        let firmware = self.firmware;
        let frame = |report| match report {
            Report::Received(frame, _) => frame,
            other => panic!("{firmware:?} reports {other:?}"),
        };
        self.take_reports().into_iter().map(frame).collect()
    }

    /// The answers that the peer heard since the last call.
    pub fn take_answers(&mut self) -> Vec<Frame> {
        let heard = std::mem::take(&mut self.heard);
        let frames = heard.into_iter().map(|(_, frame)| frame);
        frames.filter(|frame| frame.id != COUNTER_ID).collect()
    }

    /// The counter frames that the peer heard since the last call, with their times.
    pub fn take_counters(&mut self) -> Vec<(Cycles, Frame)> {
        let heard = std::mem::take(&mut self.heard);
        heard.into_iter().filter(|(_, frame)| frame.id == COUNTER_ID).collect()
    }

    /// Frames that passed the chip's filters and have left it since the last call.
    pub fn take_frame_log(&mut self) -> Vec<LoggedFrame> {
        self.chip.borrow_mut().take_frame_log()
    }

    /// The SPI instructions since the last call.
    pub fn take_instructions(&mut self) -> Vec<Instruction> {
        self.instructions.take()
    }

    /// What the chip's register holds.
    pub fn register(&self, address: u8) -> u8 {
        self.chip.borrow().register(address)
    }

    pub fn sample_point_permille(&self) -> u32 {
        self.chip.borrow().sample_point_permille()
    }

    pub fn frames_lost(&self) -> u32 {
        self.chip.borrow().rx_overflows()
    }

    /// What the AVR, the MCP2515 and the board complain about since the last call.
    pub fn take_violations(&mut self) -> Vec<String> {
        let violations = self.bench.board(0).take_violations().into_iter();
        violations.map(|violation| format!("{}: {}", violation.source, violation.text)).collect()
    }

    /// The end of a test in which the driver did nothing that the datasheet forbids.
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
        self.heard.extend(self.peer.borrow_mut().take_received());
    }
}

/// The frame by which the firmware answers.
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

/// The chip, and a note of each byte.
struct Spied {
    chip: Rc<RefCell<Mcp2515>>,
    current: Rc<RefCell<Instruction>>,
}

impl SpiDevice for Spied {
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

/// Writes down all that passes between the AVR and the chip.
fn spy(board: &mut Board, chip: &Rc<RefCell<Mcp2515>>, cs: Pin) -> Rc<RefCell<Vec<Instruction>>> {
    let instructions = Rc::new(RefCell::new(Vec::new()));
    let current = Rc::new(RefCell::new(Instruction::default()));
    board.avr_mut().connect_spi(Box::new(Spied { chip: chip.clone(), current: current.clone() }));
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
