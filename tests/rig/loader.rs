//! The bootloader, observed where it takes the longest: from a reset to the start of the longest
//! program, and while other nodes keep its frames from the bus.

use std::cell::RefCell;
use std::fs;
use std::rc::Rc;

use bench::avr::{Avr, Firmware, ResetCause};
use bench::board::Board;
use bench::can::{Frame, SoftNode};
use bench::wiring::{Wiring, preset};
use bench::{Bench, bootloader, firmware_for};
use bounds::annotations::Annotations;
use bounds::chip::Chip;
use bounds::report::{Report, Scope};

use crate::observed::{Observed, Observer, Pair};
use crate::{MS, started_with};

/// Hardware version and length in the header of a program (docs/update.md).
const HARDWARE: usize = 0x68;
const LENGTH: usize = 0x6C;

/// Less than the loader waits for a frame to leave, 0.32 s.
const BLOCKED_MS: u64 = 310;
/// Until a NodeStatus, which the loader sends each second, waits for the bus.
const BEFORE_MS: u64 = 1100;
/// The NodeStatus, and the frames of a response of GetNodeInfo.
const FRAMES: usize = 1 + 7;
/// A pause on the bus in which the loader can begin a frame.
const PAUSE_US: u64 = 60;

/// A request of GetNodeInfo from node 127, and a message of it that the filters reject. Both win
/// each arbitration against the node.
const REQUEST: (u32, u8) = (0x0001_F8FF, 0xC0);
const MESSAGE: (u32, u8) = (0x0000_017F, 0xC0);

/// What is proved of the loader of a board.
///
/// # Panics
/// If the loader was not built, or cannot be followed.
pub fn report(wiring: &Wiring) -> Report {
    let hex = bootloader(wiring).unwrap_or_else(|error| panic!("{error:#}"));
    let elf = fs::read(hex.with_extension("elf")).expect("the ELF is beside the HEX file");
    let text = bench::root().join("avr-specs/bounds-boot.toml");
    let text = fs::read_to_string(text).expect("the annotations");
    let annotations = Annotations::parse(&text).expect("annotations");
    let chip: Chip = wiring.chip.name().parse().expect("a chip");
    Report::of(&elf, chip, annotations, Scope::Everything)
        .unwrap_or_else(|error| panic!("{error:#}"))
}

/// The figures that are proved of the loader of a board beside those that were seen.
///
/// # Panics
/// If the loader was not built.
pub fn observed(wiring: &Wiring, report: &Report) -> Vec<Pair> {
    let start = start(wiring, report);
    let mut busy = busy(wiring, report);
    busy.start = start.start;
    busy.lowest_sp = busy.lowest_sp.min(start.lowest_sp);
    busy.beside(report)
}

/// A board with the loader and a program, powered up now.
fn board(wiring: &Wiring, program: &[u8]) -> Board {
    let loader = bootloader(wiring).and_then(|hex| Firmware::read_hex(&hex));
    let loader = loader.unwrap_or_else(|error| panic!("{error:#}"));
    let mut avr = Avr::programmed(wiring.chip, &loader).unwrap_or_else(|error| panic!("{error:#}"));
    avr.load_flash(0, program);
    // Without a unique ID the loader makes one first.
    let elf = firmware_for(&wiring.board, &wiring.shield, &preset(wiring.chip));
    avr.set_eeprom(started_with(&elf.unwrap_or_else(|error| panic!("{error:#}"))));
    avr.set_reset_vector(loader.flash[0].0 as u32);
    avr.reset(ResetCause::PowerOn);
    Board::in_corner(avr, wiring).unwrap_or_else(|error| panic!("{error:#}"))
}

/// The start of the longest program, which the loader checks byte by byte.
fn start(wiring: &Wiring, report: &Report) -> Observed {
    let mut board = board(wiring, &longest_program(wiring));
    let times = report.times.as_ref().expect("times");
    let observer = Observer::begin(board.avr_mut(), times);
    let mut bench = Bench::new(wiring.fastest_bit_rate());
    bench.add_board(board, "node");
    bench.run_for_ms(300);
    observer.observed()
}

/// A program of the greatest length with a CRC, which jumps to itself.
fn longest_program(wiring: &Wiring) -> Vec<u8> {
    let boot_section = report(wiring).times.expect("times").entry as usize;
    let mut program: Vec<u8> = (0..boot_section).map(|n| (n * 7) as u8).collect();
    // RJMP to itself.
    program[..2].copy_from_slice(&[0xFF, 0xCF]);
    program[HARDWARE..HARDWARE + 2].copy_from_slice(&hardware_version(wiring));
    program[LENGTH..LENGTH + 2].copy_from_slice(&(boot_section as u16).to_le_bytes());
    program.truncate(boot_section - 2);
    // CRC-16-CCITT-FALSE.
    let crc = program.iter().fold(0xFFFF_u16, |crc, byte| {
        let crc = crc ^ u16::from(*byte) << 8;
        (0..8).fold(crc, |crc, _| crc << 1 ^ if crc & 0x8000 != 0 { 0x1021 } else { 0 })
    });
    program.extend(crc.to_be_bytes());
    program
}

/// The hardware version in the header of the board's programs.
fn hardware_version(wiring: &Wiring) -> [u8; 2] {
    let elf = firmware_for(&wiring.board, &wiring.shield, &preset(wiring.chip));
    let firmware = elf.and_then(|elf| Firmware::read(&elf));
    let firmware = firmware.unwrap_or_else(|error| panic!("{error:#}"));
    let (_, code) = firmware.flash.iter().find(|(address, _)| *address == 0).expect("vectors");
    [code[HARDWARE], code[HARDWARE + 1]]
}

/// A response of seven frames, each of which waits almost as long as the loader lets it.
fn busy(wiring: &Wiring, report: &Report) -> Observed {
    let bit_rate = wiring.fastest_bit_rate();
    let mut bench = Bench::new(bit_rate);
    let observer_of =
        |board: &mut Board| Observer::begin(board.avr_mut(), report.times.as_ref().expect("times"));
    let mut board = board(wiring, &[]);
    let observer = observer_of(&mut board);
    bench.add_board(board, "node");
    let peer = Rc::new(RefCell::new(SoftNode::new(bit_rate)));
    bench.attach("peer", peer.clone());
    // Acknowledges.
    bench.attach("other", Rc::new(RefCell::new(SoftNode::new(bit_rate))));
    let send = |(id, tail): (u32, u8), len: usize| {
        let mut data = vec![0; len];
        data[len - 1] = tail;
        peer.borrow_mut().send(Frame::extended(id, &data));
    };
    // The loader listens before it sends.
    for _ in 0..10 {
        send(MESSAGE, 8);
    }
    bench.run_for_ms(20);
    let blocks = [BEFORE_MS].into_iter().chain([BLOCKED_MS; FRAMES]);
    for (block, ms) in blocks.enumerate() {
        if block == 1 {
            send(REQUEST, 1);
        }
        let end = bench.now() + ms * MS;
        while bench.now() < end {
            while peer.borrow().queued() < 3 {
                send(MESSAGE, 8);
            }
            bench.run_until(bench.now() + MS / 10);
        }
        while block > 0 && peer.borrow().queued() > 0 {
            bench.run_until(bench.now() + MS / 100);
        }
        if block > 0 {
            bench.run_until(bench.now() + PAUSE_US * MS / 1000);
        }
    }
    observer.observed()
}
