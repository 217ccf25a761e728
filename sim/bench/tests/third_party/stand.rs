//! The test stand: a firmware with a third-party driver on a board, a peer that sends to it, and a
//! recorder on its SPI.
//!
//! This file repeats the constants of the firmwares (`tests/third-party/src/job.rs`) on purpose, so
//! that an error there shows.

use bench::Cycles;
use bench::board::{Board, WireEvent};
use bench::can::{Fault, Frame, Id, SoftNode};
use bench::mcp2515::{LoggedFrame, Mcp2515};
use bench::wiring::Wiring;
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

/// The Arduino and the CAN board on which a firmware runs: a shield with CS on D9, 16 MHz and 1
/// Mbit/s, or a module with CS on D10, 8 MHz and 500 kbit/s.
pub type Place = (&'static str, &'static str);

/// The place in which every test runs. Some tests also run in the other places.
pub const DEFAULT: Place = ("diecimila", "seeed");
pub const PLACES: [Place; 4] =
    [DEFAULT, ("diecimila", "module"), ("uno", "seeed"), ("uno", "module")];

impl ThirdParty {
    fn elf(self, wiring: &Wiring) -> PathBuf {
        let name = match self {
            ThirdParty::Mcp2515 => "third-party-mcp2515-crate",
            ThirdParty::Mcp25xx => "third-party-mcp25xx-crate",
            ThirdParty::Mcp25xxWrongRxb1 => "third-party-mcp25xx-wrong-rxb1",
        };
        let suffix = if wiring.shield_name() == "module" { "-module" } else { "" };
        let file = format!("avr-{}/firmware/{name}{suffix}.elf", wiring.chip.name());
        let path = target_dir().join(file);
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
    place: Place,
    bench: Bench,
    peer: Rc<RefCell<SoftNode>>,
    chip: Rc<RefCell<Mcp2515>>,
    /// The last one is in progress.
    instructions: Vec<Instruction>,
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
        let wiring = Wiring::of(place.0, place.1).expect("boards of the table");
        let bit_rate = wiring.fastest_bit_rate();
        let board =
            Board::load_as(&firmware.elf(&wiring), &wiring).expect("a firmware for the chip");
        let chip = board.chip();
        let mut bench = Bench::new(bit_rate);
        let index = bench.add_board(board, "third-party");
        let peer = Rc::new(RefCell::new(SoftNode::new(bit_rate)));
        bench.attach("peer", peer.clone());
        bench.board(index).attach_probe();
        let mut stand = Stand {
            firmware,
            place,
            bench,
            peer,
            chip,
            instructions: vec![Instruction::default()],
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
        let current = self.instructions.pop().into_iter().collect();
        std::mem::replace(&mut self.instructions, current)
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

    /// The firmware has reported these frames since the last call. `what` says which case it is.
    #[track_caller]
    pub fn assert_reported(&mut self, frames: &[Frame], what: &str) {
        let reported = self.take_frames_reported();
        assert_eq!(reported, frames, "{:?} {:?} {what}", self.firmware, self.place);
    }

    /// The firmware has reported these frames, and sent their answers in the same order.
    #[track_caller]
    pub fn assert_answered(&mut self, frames: &[Frame], what: &str) {
        self.assert_reported(frames, what);
        let expected: Vec<Frame> = frames.iter().map(answer_to).collect();
        assert_eq!(self.take_answers(), expected, "{:?} {:?} {what}", self.firmware, self.place);
    }

    fn collect(&mut self) {
        for (at, event) in self.bench.board(0).take_wire_events() {
            let current = self.instructions.last_mut().expect("one in progress");
            match event {
                WireEvent::Cs(false) => current.start = at,
                WireEvent::Cs(true) => {
                    current.end = at;
                    self.instructions.push(Instruction::default());
                }
                WireEvent::Spi { byte, miso } => {
                    current.mosi.push(byte.mosi);
                    current.miso.push(miso);
                }
                _ => {}
            }
        }
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

/// Fails if the driver did something that the datasheet forbids.
impl Drop for Stand {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            let violations = self.take_violations();
            assert!(violations.is_empty(), "{:?} {:?} {violations:?}", self.firmware, self.place);
        }
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
