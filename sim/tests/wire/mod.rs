//! The bench for tests of logs and VCD files: the node, an autopilot, and a peer that sends frames
//! of every kind.

#![allow(dead_code, reason = "each test file uses some of these")]

use crate::avr::MS;
use bench::Cycles;
use bench::autopilot::{Autopilot, Settings};
use bench::board::Board;
use bench::can::{Frame, Id, Record, RecordKind, SoftNode};
use bench::{Bench, eeprom_after_first_start, node_elf};
use std::cell::RefCell;
use std::path::Path;
use std::process::{Command, Stdio};
use std::rc::Rc;
use std::sync::OnceLock;

pub const BIT_RATE: u32 = 1_000_000;

/// A bench with the node, an autopilot, and a peer.
pub struct Rig {
    pub bench: Bench,
    pub node: usize,
    autopilot: Autopilot,
    peer: Rc<RefCell<SoftNode>>,
}

/// Frames of the peer: both kinds of identifiers, every length, remote frames, and sequences of
/// equal bits, which are stuffed.
pub fn peer_frames() -> Vec<Frame> {
    let data = [0x00, 0xFF, 0x55, 0xAA, 0x0F, 0xF8, 0x1C, 0x80];
    let mut frames = Vec::new();
    for length in 0..=8 {
        frames.push(Frame::extended(0x0800_0000 + length as u32, &data[..length]));
        frames.push(Frame::standard(0x7C0 + length as u16, &data[8 - length..]));
    }
    frames.push(Frame::remote(Id::Standard(0x555), 8));
    frames.push(Frame::remote(Id::Extended(0x1000_FFFF), 0));
    // Not identifier 0: one of tshark's dissectors would decode its data and not show it.
    frames.push(Frame::extended(1 << 20, &[0; 8]));
    frames
}

/// The EEPROM of a node after its first start.
fn eeprom() -> &'static [u8] {
    static EEPROM: OnceLock<Vec<u8>> = OnceLock::new();
    EEPROM.get_or_init(|| {
        eeprom_after_first_start(&node_elf().expect("the table has its defaults"))
            .expect("run `make firmware`")
    })
}

impl Rig {
    /// Each rig gives the same run.
    pub fn new() -> Rig {
        let mut board = Board::load(&node_elf().expect("the table has its defaults"))
            .expect("run `make firmware`");
        board.avr_mut().set_eeprom(eeprom());
        let mut bench = Bench::new(BIT_RATE);
        let node = bench.add_board(board, "node");
        let mut autopilot = Autopilot::new(Settings::default(), BIT_RATE);
        autopilot.hold(0.5);
        bench.attach("autopilot", autopilot.station());
        let peer = Rc::new(RefCell::new(SoftNode::new(BIT_RATE)));
        bench.attach("peer", peer.clone());
        for (frame, number) in peer_frames().into_iter().zip(0..) {
            peer.borrow_mut().send_at(10 * MS + number * MS, frame);
        }
        Rig { bench, node, autopilot, peer }
    }

    /// Runs for `milliseconds`, and calls `turn` after each millisecond with the records of the
    /// bus.
    pub fn run(&mut self, milliseconds: u64, mut turn: impl FnMut(&mut Bench, &[Record])) {
        for _ in 0..milliseconds {
            let until = self.bench.now() + MS;
            self.autopilot.advance(until);
            self.bench.run_until(until);
            self.peer.borrow_mut().take_received();
            let records = self.bench.bus().take_records();
            turn(&mut self.bench, &records);
        }
    }
}

/// The frames of the records, with their starts. Panics at an error frame.
#[track_caller]
pub fn frames(records: &[Record]) -> Vec<(Cycles, Frame)> {
    let frame = |record: &Record| match record.kind {
        RecordKind::Frame { frame, .. } => (record.start, frame),
        RecordKind::ErrorFrame { .. } => panic!("an error frame: {record:?}"),
    };
    records.iter().map(frame).collect()
}

/// The standard output of a program.
#[track_caller]
pub fn output(program: &str, arguments: &[&str]) -> Vec<u8> {
    let run = Command::new(program).args(arguments).stdin(Stdio::null()).output();
    let output = run.unwrap_or_else(|error| {
        panic!("{program} cannot be run ({error}): run `scripts/setup test`")
    });
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{program} {arguments:?}: {errors}");
    output.stdout
}

#[track_caller]
pub fn lines(program: &str, arguments: &[&str]) -> Vec<String> {
    let text = String::from_utf8(output(program, arguments)).unwrap();
    text.lines().map(str::to_owned).collect()
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}
