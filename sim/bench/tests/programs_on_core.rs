//! Runs the shipped firmware on `avr-core` beside a simulated board with simavr, and compares
//! registers, SREG, stack pointer, program counter and cycles after each instruction, and the SRAM
//! at the end.
//!
//! `avr-core` has no peripherals: what it reads of I/O registers, and its interrupts, come from the
//! board, which executes each instruction first.

use std::path::Path;

use bench::avr::{Registers, Resume};
use bench::board::Board;
use bench::firmware::firmware_for;
use bench::{Bench, Cycles, F_CPU_HZ};

use avr_core::{Bus, Chip, Clock, Core};

/// Instructions of each comparison.
const INSTRUCTIONS: u32 = 1_000_000;
/// Time at which the node has written its first EEPROM and runs its main loop.
const RUNNING: Cycles = 5 * F_CPU_HZ;
/// The node's default.
const BIT_RATE: u32 = 500_000;
/// Bytes of the vector table of both chips.
const VECTORS_END: u32 = 26 * 4;
const I: u8 = 0x80;

/// The I/O registers and interrupts that the board showed.
#[derive(Default)]
struct Echo {
    value: u8,
    pending: Option<u8>,
}

impl Bus for Echo {
    fn read(&mut self, _address: u16, _clock: &mut Clock) -> u8 {
        self.value
    }

    fn write(&mut self, address: u16, value: u8, clock: &mut Clock) {
        clock.now += halt_cycles(address, value);
    }

    fn write_bit(&mut self, address: u16, mask: u8, set: bool, clock: &mut Clock) {
        if set {
            clock.now += halt_cycles(address, mask);
        }
    }

    fn take_interrupt(&mut self, _clock: &mut Clock) -> Option<u8> {
        self.pending.take()
    }
}

/// > When the EEPROM is read, the CPU is halted for four clock cycles before the next instruction
/// > is executed. When the EEPROM is written, the CPU is halted for two clock cycles
/// > (DS40002061B, 8.4)
fn halt_cycles(address: u16, value: u8) -> u64 {
    const EECR: u16 = 0x3F;
    const EERE: u8 = 1;
    const EEPE: u8 = 1 << 1;
    match address {
        EECR if value & EERE != 0 => 4,
        EECR if value & EEPE != 0 => 2,
        _ => 0,
    }
}

/// The byte that an instruction has read, if it reads one: `next` is the address of the next
/// instruction without an interrupt.
fn value_read(opcode: u16, at: u32, next: u32, after: &Registers) -> u8 {
    match opcode & 0xFF00 {
        // SBIC, SBIS
        0x9900 if next == at + 2 => 0xFF,
        0x9B00 if next != at + 2 => 0xFF,
        0x9900 | 0x9B00 => 0,
        _ => after.r[usize::from(opcode >> 4 & 31)],
    }
}

/// Compares from time `start` on. Returns the number of interrupts.
fn compare(elf: &Path, start: Cycles) -> u32 {
    let mut bench = Bench::new(BIT_RATE);
    bench.add_board(Board::load(elf).expect("a board"), "node");
    bench.run_until(start);
    let board = bench.board(0);
    let debugger = board.avr_mut().debugger();
    let ram = 0x0100..=board.avr().chip().ram_end();
    let chip =
        if *ram.end() == Chip::ATmega168.ram_end() { Chip::ATmega168 } else { Chip::ATmega328P };
    let mut core = Core::new(chip);
    core.write_flash(0, &board.avr().flash());
    let first = debugger.registers();
    (core.registers, core.sreg, core.sp) = (first.r, first.sreg, first.sp);
    core.set_pc(first.pc);
    core.ram_mut().copy_from_slice(&board.avr().sram_range(ram.clone()));
    core.clock.now = board.now();
    let mut echo = Echo::default();
    let mut interrupts = 0;
    for _ in 0..INSTRUCTIONS {
        let before = debugger.registers();
        debugger.resume(Resume::Step);
        board.run_until(board.now() + 1000);
        let after = debugger.registers();
        let at = before.pc as usize;
        let opcode = u16::from_le_bytes([core.flash()[at], core.flash()[at + 1]]);
        // An interrupt follows the instruction in the same step.
        let is_entry = after.pc < VECTORS_END && after.sreg & I == 0;
        let next = if is_entry {
            let [high, low] = [1, 2].map(|byte| board.avr().sram(after.sp + byte));
            2 * u32::from(u16::from_be_bytes([high, low]))
        } else {
            after.pc
        };
        echo.value = value_read(opcode, before.pc, next, &after);
        core.step(&mut echo).expect("an instruction");
        if core.pc() != after.pc && is_entry {
            echo.pending = Some((after.pc / 4) as u8);
            core.step(&mut echo).expect("an entry");
            interrupts += 1;
        }
        let own = Registers { r: core.registers, sreg: core.sreg, sp: core.sp, pc: core.pc() };
        assert_eq!(
            (own, core.clock.now),
            (after, board.now()),
            "{}: {opcode:#06x} after {before:x?}",
            elf.display()
        );
    }
    assert_eq!(core.ram(), board.avr().sram_range(ram));
    interrupts
}

#[test]
fn the_shipped_firmware_runs_on_avr_core_as_on_simavr() {
    let programs = [
        ("diecimila", "default"),
        ("diecimila", "remote"),
        ("diecimila", "thesis"),
        ("uno", "full"),
    ];
    for (board, features) in programs {
        let elf = firmware_for(board, "seeed", features).expect("the firmware");
        compare(&elf, 0);
        let interrupts = compare(&elf, RUNNING);
        assert!(interrupts > 50, "{features}: only {interrupts} interrupts");
    }
}
