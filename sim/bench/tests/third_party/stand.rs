//! The test stand: a firmware with a third-party driver on a board, and a peer that sends to it.
//!
//! This file repeats the constants of the firmwares (`tests/third-party/src/job.rs`) on purpose, so
//! that an error there shows.

use bench::board::Board;
use bench::can::{Frame, Id, SoftNode};
use bench::mcp2515::{LoggedFrame, Mcp2515};
use bench::wiring::Wiring;
use bench::{Bench, target_dir};
use std::cell::RefCell;
use std::path::PathBuf;
use std::rc::Rc;

/// Identifier of the frames that the firmware sends periodically.
const COUNTER_ID: Id = Id::Extended(0x18C0_FFEE);
/// Time in which the firmware answers and reports three frames; one frame takes 3.3 ms.
const SERVED_MS: u64 = 12;

const BOOT_LIMIT_MS: u64 = 50;

/// A firmware with a third-party driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ThirdParty {
    /// With the crate `mcp2515` 0.3.
    Mcp2515,
    /// With the crate `mcp25xx` 0.4.
    Mcp25xx,
}

/// The Arduino and the CAN board on which a firmware runs: a shield with CS on D9, 16 MHz and 1
/// Mbit/s, or a module with CS on D10, 8 MHz and 500 kbit/s.
pub type Place = (&'static str, &'static str);

/// Every test runs in the first place, and some tests in all.
pub const PLACES: [Place; 4] =
    [("diecimila", "seeed"), ("diecimila", "module"), ("uno", "seeed"), ("uno", "module")];

impl ThirdParty {
    fn elf(self, wiring: &Wiring) -> PathBuf {
        let name = match self {
            ThirdParty::Mcp2515 => "third-party-mcp2515-crate",
            ThirdParty::Mcp25xx => "third-party-mcp25xx-crate",
        };
        let suffix = if wiring.shield_name() == "module" { "-module" } else { "" };
        let file = format!("avr-{}/firmware/{name}{suffix}.elf", wiring.chip.name());
        let path = target_dir().join(file);
        assert!(path.exists(), "{} is missing: run `make third-party`", path.display());
        path
    }
}

/// A line that the firmware sends on its serial port.
#[derive(Debug, PartialEq)]
pub enum Report {
    Configured,
    /// A frame that the crate returned.
    Received(Frame),
    /// The crate returned an error.
    Failed,
}

impl Report {
    fn parse(line: &str) -> Report {
        let words: Vec<&str> = line.split(' ').collect();
        match words[..] {
            ["I"] => Report::Configured,
            ["E" | "X"] => Report::Failed,
            // The number is the cycles of the crate's call.
            ["R", _, frame] => Report::Received(frame.parse().expect("a frame")),
            _ => panic!("not a report: {line:?}"),
        }
    }
}

/// A firmware on a board, with a peer on its bus.
pub struct Stand {
    firmware: ThirdParty,
    place: Place,
    bench: Bench,
    peer: Rc<RefCell<SoftNode>>,
    chip: Rc<RefCell<Mcp2515>>,
    serial: Vec<u8>,
    reports: Vec<Report>,
    received: Vec<Frame>,
}

impl Stand {
    /// The firmware on the default board, booted until its chip is on the bus.
    #[track_caller]
    pub fn new(firmware: ThirdParty) -> Stand {
        Stand::at(PLACES[0], firmware)
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
        bench.add_board(board, "third-party");
        let peer = Rc::new(RefCell::new(SoftNode::new(bit_rate)));
        bench.attach("peer", peer.clone());
        let mut stand = Stand {
            firmware,
            place,
            bench,
            peer,
            chip,
            serial: vec![],
            reports: vec![],
            received: vec![],
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
        self.run_ms(1);
        self.send(others);
        self.run_ms(SERVED_MS);
    }

    fn take_reports(&mut self) -> Vec<Report> {
        std::mem::take(&mut self.reports)
    }

    /// Removes and returns the answers that the peer received since the last call.
    pub fn take_answers(&mut self) -> Vec<Frame> {
        let mut received = std::mem::take(&mut self.received);
        received.retain(|frame| frame.id != COUNTER_ID);
        received
    }

    /// Removes and returns the frames that passed the chip's filters and were read or lost since
    /// the last call.
    pub fn take_frame_log(&mut self) -> Vec<LoggedFrame> {
        self.chip.borrow_mut().take_frame_log()
    }

    /// The firmware has reported these frames, and nothing else, since the last call.
    #[track_caller]
    pub fn assert_reported(&mut self, frames: &[Frame]) {
        let expected: Vec<Report> = frames.iter().copied().map(Report::Received).collect();
        assert_eq!(self.take_reports(), expected, "{:?} {:?}", self.firmware, self.place);
    }

    /// The firmware has reported these frames, and sent their answers in the same order.
    #[track_caller]
    pub fn assert_answered(&mut self, frames: &[Frame]) {
        self.assert_reported(frames);
        let expected: Vec<Frame> = frames.iter().map(answer_to).collect();
        assert_eq!(self.take_answers(), expected, "{:?} {:?}", self.firmware, self.place);
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
        let received = self.peer.borrow_mut().take_received();
        self.received.extend(received.into_iter().map(|(_, frame)| frame));
    }
}

/// Fails if the driver did something that the datasheet forbids.
impl Drop for Stand {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            let violations = self.bench.board(0).take_violations();
            assert_eq!(violations, [], "{:?} {:?}", self.firmware, self.place);
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
