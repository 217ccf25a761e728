//! own-node on arduino-hal, on simulated boards whose processor is `avr-core`, with an interrupt at
//! each instruction.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use bench::avr::Chip;
use bench::board::Board;
use bench::can::{Frame, Id, SoftNode};
use bench::wiring::Wiring;
use bench::{Bench, Cycles, target_dir};

const BIT_RATE: u32 = 1_000_000;
const MS: Cycles = 16_000;
/// Byte address of the vector of INT0.
const INT0: u32 = 4;
/// Data address of SREG, and its flag I.
const SREG: u32 = 0x5F;
const I: u8 = 0x80;
/// Time between two bursts of frames.
const SCHEDULE: Cycles = 100 * MS;

/// Falling edges of INT come beside those of the MCP2515, until the handler has run before each
/// instruction of the main loop that does not exclude it. It runs an instruction after the edge.
fn assert_works_with_an_interrupt_at_each_instruction(board: &str, chip: Chip) {
    let wiring = Wiring { chip, crystal_mhz: 16, ..Wiring::of(board, "module").unwrap() };
    let elf = target_dir().join(format!("own-node/{board}.elf"));
    let mut bench = Bench::new(BIT_RATE);
    bench.add_board(Board::load_as(&elf, &wiring).unwrap(), board);
    let peer = Rc::new(RefCell::new(SoftNode::new(BIT_RATE)));
    bench.attach("peer", peer.clone());
    bench.run_for_ms(20);

    let start = bench.now();
    // What has followed each instruction, and the instructions before which the handler has run.
    let mut followers = BTreeMap::<u32, BTreeSet<u32>>::new();
    let mut interrupted = BTreeSet::new();
    let chip = bench.board(0).avr_mut().debugger();
    let (mut before, mut enabled_at) = (bench.board(0).avr().now(), None);
    for number in 0..4 {
        let at = start + number * SCHEDULE;
        let value = [0x38, 0x34, 0xB8, 0xB4][number as usize % 4];
        let mut peer = peer.borrow_mut();
        // In a row, a command for another actuator and one for this.
        peer.send_at(at, Frame::extended(0x1003_F20A, &[2, 0, 0, 0x3C, 0xC0 | number as u8]));
        let tail = 0xC0 | (16 + number as u8);
        peer.send_at(at, Frame::extended(0x1003_F20A, &[1, 0, 0, value, tail]));
        // A request, whose response is sent meanwhile.
        peer.send_at(at, Frame::extended(0x1E01_AA8A, &[0xC0 | number as u8]));
    }
    let mut pulses = vec![];
    while bench.now() < start + 4 * SCHEDULE {
        let next = bench.now() + 1;
        bench.run_until(next);
        let board = bench.board(0);
        pulses.extend(board.take_servo_pulses());
        let avr = board.avr();
        if avr.now() == before {
            continue;
        }
        before = avr.now();
        let is_enabled = chip.data(SREG).unwrap() & I != 0;
        let mut pc = avr.pc();
        if pc == INT0 {
            let [high, low] = [1, 2].map(|offset| avr.sram(avr.sp() + offset));
            pc = u32::from(u16::from_be_bytes([high, low])) * 2;
            interrupted.insert(pc);
        }
        if let Some(previous) = enabled_at
            && (is_enabled || avr.pc() == INT0)
        {
            followers.entry(previous).or_default().insert(pc);
        }
        enabled_at = is_enabled.then_some(pc);
        let are_done = |all: &BTreeSet<_>| all.is_subset(&interrupted);
        if is_enabled && !followers.get(&pc).is_some_and(are_done) {
            let level = board.chip().borrow().int_pin();
            board.set_stuck_int(Some(!level));
            board.set_stuck_int(None);
        }
    }

    let possible: BTreeSet<_> = followers.into_values().flatten().collect();
    let missing: Vec<_> = possible.difference(&interrupted).map(|pc| format!("{pc:#x}")).collect();
    assert!(missing.is_empty(), "of {} instructions no interrupt at {missing:?}", possible.len());
    assert!(possible.len() > 1500, "{} instructions", possible.len());
    assert_eq!(bench.board(0).chip().borrow().rx_overflows(), 0);
    assert!(bench.board(0).take_violations().is_empty());
    let received = peer.borrow_mut().take_received();
    let answers = received.iter().filter(|(_, frame)| frame.id == Id::Extended(0x1E01_0AAA));
    assert_eq!(answers.count(), 4 * 9);
    let mut widths: Vec<_> = pulses.iter().map(|pulse| pulse.width_cycles / 16).collect();
    widths.dedup();
    let expected = [1750, 1625, 1250, 1375];
    assert!(widths.ends_with(&expected), "{widths:?}");
}

#[test]
#[ignore = "make own-node-uno builds the program"]
fn an_uno_works_with_an_interrupt_at_each_instruction() {
    assert_works_with_an_interrupt_at_each_instruction("uno", Chip::Atmega328p);
}

#[test]
#[ignore = "make own-node-uno builds the program"]
fn a_diecimila_works_with_an_interrupt_at_each_instruction() {
    assert_works_with_an_interrupt_at_each_instruction("diecimila", Chip::Atmega168);
}
