//! What a program does between instructions and at the ends of its memories. What each instruction
//! does to registers, flags and memory `sim/bench/tests/opcodes.rs` compares with simavr.

use super::*;
use alloc::vec::Vec;

/// A core before the program `words`.
fn core(words: &[u16]) -> Core {
    let mut core = Core::new(Chip::ATmega328P);
    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    core.write_flash(0, &bytes);
    core
}

/// A bus with what the tests ask for.
#[derive(Default)]
struct TestBus {
    io: NoPeripherals,
    pending: Option<u8>,
    table: u32,
    sleeps: bool,
    spm: Option<Spm>,
    watchdog_resets: u32,
    breaks: u32,
    /// A write asks for attention.
    asks: bool,
    /// A write causes this interrupt.
    causes: Option<u8>,
    reads: u32,
    /// What the core has told of the stack: pointer, by hand, address of the instruction.
    stack: Vec<(u16, bool, u32)>,
}

impl Bus for TestBus {
    fn read(&mut self, address: u16, clock: &mut Clock) -> u8 {
        self.reads += 1;
        self.io.read(address, clock)
    }

    fn write(&mut self, address: u16, value: u8, clock: &mut Clock) {
        if self.asks {
            clock.ask_for_attention();
        }
        if self.causes.is_some() {
            self.pending = self.causes.take();
            clock.check_interrupts();
        }
        self.io.write(address, value, clock);
    }

    fn write_bit(&mut self, address: u16, mask: u8, set: bool, clock: &mut Clock) {
        self.io.write_bit(address, mask, set, clock);
    }

    fn take_interrupt(&mut self, _clock: &mut Clock) -> Option<u8> {
        self.pending.take()
    }

    fn store_program_memory(&mut self, spm: Spm, clock: &mut Clock) {
        self.spm = Some(spm);
        clock.now += 10;
    }

    fn sleep(&mut self, _clock: &mut Clock) -> bool {
        self.sleeps
    }

    fn reset_watchdog(&mut self, _clock: &mut Clock) {
        self.watchdog_resets += 1;
    }

    fn break_point(&mut self, _clock: &mut Clock) {
        self.breaks += 1;
    }

    fn stack_below_mark(&mut self, sp: u16, is_set_by_hand: bool, clock: &mut Clock) {
        self.stack.push((sp, is_set_by_hand, clock.instruction()));
    }

    fn vector_table(&self) -> u32 {
        self.table
    }
}

const SEI: u16 = 0x9478;
const SLEEP: u16 = 0x9588;

#[test]
fn a_skip_takes_a_cycle_for_each_word_that_it_skips() {
    // SBRS r16, 0 over NOP and over JMP; SBRC does not skip.
    for (words, pc, cycles) in [
        ([0xFF00, 0x0000, 0], 4, 2),
        ([0xFF00, 0x940C, 0], 6, 3),
        ([0xFF00, 0x9100, 0], 6, 3),
        ([0xFD00, 0x0000, 0], 2, 1),
    ] {
        let mut core = core(&words);
        core.registers[16] = 1;
        core.step(&mut NoPeripherals::default()).expect("an instruction");
        assert_eq!((core.pc(), core.clock.now), (pc, cycles), "{words:x?}");
    }
}

/// Push, rcall, an interrupt, and room for variables: SPH, SREG, SPL, as compilers write them.
#[test]
fn a_stack_below_its_mark_is_told_once_for_each_depth() {
    let program = [0x920F, 0x900F, 0x920F, 0xD000, 0x9478, 0, 0, 0xBFDE, 0xBE0F, 0xBFCD];
    let mut core = core(&program);
    (core.registers[28], core.registers[29]) = (0x80, 0x07);
    let bus = &mut TestBus { pending: Some(0), table: 12, ..TestBus::default() };
    core.run(bus, 19).expect("instructions");
    assert_eq!(core.sp, 0x0780);
    let expected =
        [(0x08FE, false, 0), (0x08FC, false, 6), (0x08FA, false, 10), (0x0780, false, 18)];
    assert_eq!(bus.stack, expected);
    assert_eq!(core.stack_mark(), 0x0780);
    // A higher mark is passed again, at the first byte below it.
    core.sp = 0x0802;
    core.set_stack_mark(0x0800);
    core.write_flash(20, &[0x0F, 0x92].repeat(4));
    core.run(bus, 27).expect("instructions");
    assert_eq!(bus.stack[4..], [(0x07FF, false, 24), (0x07FE, false, 26)]);
}

#[test]
fn a_stack_pointer_whose_high_byte_is_written_last_is_set_by_hand() {
    // `out SPL, r28`, `out SPH, r29`, `push r0`.
    let mut core = core(&[0xBFCD, 0xBFDE, 0x920F]);
    (core.registers[28], core.registers[29]) = (0xFF, 0x03);
    let bus = &mut TestBus::default();
    core.run(bus, 4).expect("instructions");
    assert_eq!(bus.stack, [(0x03FE, true, 4)]);
}

#[test]
fn flash_is_decoded_again_after_a_write_of_a_second_word() {
    let mut core = core(&[0x9100, 0x0100]);
    core.ram_mut()[0x10] = 7;
    core.write_flash(2, &0x0110_u16.to_le_bytes());
    core.step(&mut NoPeripherals::default()).expect("LDS");
    assert_eq!((core.registers[16], core.pc(), core.clock.now), (7, 4, 2));
}

#[test]
fn an_instruction_of_two_words_wraps_at_the_end_of_the_flash() {
    let mut core = core(&[0x0110]);
    core.write_flash(0x7FFE, &0x9100_u16.to_le_bytes());
    core.write_flash(0, &0x0111_u16.to_le_bytes());
    core.ram_mut()[0x11] = 9;
    core.set_pc(0x7FFE);
    core.step(&mut NoPeripherals::default()).expect("LDS");
    assert_eq!((core.registers[16], core.pc()), (9, 2));
}

#[test]
fn the_program_counter_wraps_at_the_end_of_the_smaller_flash() {
    let mut core = Core::new(Chip::ATmega168);
    core.write_flash(0x3FFE, &[0, 0]);
    core.set_pc(0x3FFE);
    core.step(&mut NoPeripherals::default()).expect("NOP");
    assert_eq!(core.pc(), 0);
}

#[test]
fn opcodes_of_other_chips_stop_the_program() {
    // 0x0001, LAS, XCH, LAC, LAT, ELPM, DES, EIJMP, EICALL, SPM Z+, ELPM r0, BLD with bit 3.
    for opcode in [
        0x0001, 0x9205, 0x9204, 0x9206, 0x9207, 0x9006, 0x9007, 0x940B, 0x9419, 0x9519, 0x95F8,
        0x95D8, 0xF808, 0xFFFF,
    ] {
        let mut core = core(&[0x0000, opcode]);
        let bus = &mut NoPeripherals::default();
        assert_eq!(core.run(bus, 10), Err(InvalidOpcode { address: 2, opcode }));
        assert_eq!((core.pc(), core.clock.now), (2, 1));
        assert_eq!(core.step(bus), Err(InvalidOpcode { address: 2, opcode }));
    }
}

#[test]
fn one_instruction_comes_between_sei_and_the_interrupt() {
    let mut core = core(&[SEI, 0x0000, 0x0000]);
    let bus = &mut TestBus { pending: Some(3), ..TestBus::default() };
    for (pc, now) in [(2, 1), (4, 2), (12, 6)] {
        core.step(bus).expect("an instruction");
        assert_eq!((core.pc(), core.clock.now), (pc, now));
    }
    assert_eq!((core.sreg, core.sp), (0, 0x08FD));
    assert_eq!(core.ram()[0x7FE..], [0x00, 0x02]);
}

#[test]
fn sei_delays_no_interrupt_if_interrupts_are_enabled() {
    let mut core = core(&[SEI, 0x0000]);
    core.sreg = 0x80;
    let bus = &mut TestBus::default();
    core.step(bus).expect("SEI");
    bus.pending = Some(1);
    core.step(bus).expect("an entry");
    assert_eq!((core.pc(), core.clock.now), (4, 5));
}

#[test]
fn one_instruction_comes_between_reti_and_the_interrupt() {
    let mut core = core(&[0x9518, 0x0000]);
    core.sp = 0x08FD;
    core.ram_mut()[0x7FF] = 1;
    let bus = &mut TestBus { pending: Some(1), table: 0x7000, ..TestBus::default() };
    core.run(bus, 6).expect("RETI and another");
    assert_eq!((core.pc(), core.sreg, core.clock.now), (0x7004, 0, 8 + 1));
}

#[test]
fn an_interrupt_in_the_middle_of_a_run_follows_the_instruction_that_causes_it() {
    // OUT 5, r16; NOP
    let mut core = core(&[0xB905, 0x0000, 0x0000]);
    core.sreg = 0x81;
    let bus = &mut TestBus { causes: Some(2), ..TestBus::default() };
    assert_eq!(core.run(bus, 5), Ok(Stop::Deadline));
    assert_eq!((core.pc(), core.sreg, core.clock.now), (8, 1, 5));
    assert_eq!(core.ram()[0x7FE..], [0x00, 0x01]);
}

#[test]
fn sleep_ends_by_an_interrupt_four_cycles_later() {
    let mut core = core(&[SEI, SLEEP, 0x0000]);
    let bus = &mut TestBus { sleeps: true, ..TestBus::default() };
    assert_eq!(core.run(bus, 100), Ok(Stop::Asleep));
    assert_eq!((core.is_asleep(), core.pc(), core.clock.now), (true, 4, 2));
    core.clock.now = 50;
    bus.pending = Some(1);
    core.step(bus).expect("a wake-up");
    assert_eq!((core.is_asleep(), core.pc(), core.clock.now), (false, 4, 58));
    // Without SE the instruction does nothing.
    bus.sleeps = false;
    core.set_pc(2);
    assert_eq!(core.step(bus), Ok(Stop::Deadline));
    assert_eq!(core.pc(), 4);
}

#[test]
fn sleep_without_interrupts_never_ends() {
    let mut core = core(&[SLEEP]);
    let bus = &mut TestBus { sleeps: true, pending: Some(1), ..TestBus::default() };
    assert_eq!(core.run(bus, 100), Ok(Stop::Asleep));
    assert_eq!(core.run(bus, 200), Ok(Stop::Asleep));
    core.reset(0x7000);
    assert_eq!((core.is_asleep(), core.pc(), core.sp), (false, 0x7000, 0x08FF));
}

#[test]
fn a_bus_can_end_the_run_and_halt_the_core() {
    // OUT 5, r16; SPM; WDR; BREAK
    let mut core = core(&[0xB905, 0x95E8, 0x95A8, 0x9598]);
    core.registers[16] = 0x5A;
    (core.registers[0], core.registers[1], core.registers[30]) = (0x34, 0x12, 0x80);
    let bus = &mut TestBus { asks: true, ..TestBus::default() };
    assert_eq!(core.run(bus, 100), Ok(Stop::Attention));
    assert_eq!((core.pc(), bus.io.io[0x25]), (2, 0x5A));
    assert_eq!(core.run(bus, 14), Ok(Stop::Deadline));
    assert_eq!(bus.spm, Some(Spm { pc: 2, z: 0x0080, word: 0x1234 }));
    assert_eq!((core.clock.now, bus.watchdog_resets, bus.breaks), (14, 1, 1));
}

#[test]
fn sbi_and_cbi_do_not_read() {
    // SBI 3, 5; CBI 3, 0; SBIC 3, 0
    let mut core = core(&[0x9A1D, 0x9818, 0x9918]);
    let bus = &mut TestBus::default();
    bus.io.io[0x23] = 1;
    core.run(bus, 4).expect("two instructions");
    assert_eq!((bus.io.io[0x23], bus.reads, core.clock.now), (0x20, 0, 4));
    core.step(bus).expect("SBIC");
    assert_eq!((bus.reads, core.pc()), (1, 8));
}

#[test]
fn the_registers_are_in_the_data_space() {
    // STS 0x0005, r16; LDS r17, 0x005D; OUT SPH, r16; IN r18, SREG
    let mut core = core(&[0x9300, 0x0005, 0x9110, 0x005D, 0xBF0E, 0xB72F]);
    core.registers[16] = 3;
    core.sreg = 0x41;
    core.run(&mut NoPeripherals::default(), 6).expect("four instructions");
    assert_eq!(core.registers[5], 3);
    assert_eq!(core.registers[17..19], [0xFF, 0x41]);
    assert_eq!(core.sp, 0x03FF);
}

#[test]
fn a_run_without_an_end_goes_on_until_the_bus_ends_it() {
    // NOP; OUT 5, r16
    let mut core = core(&[0x0000, 0xB905]);
    let bus = &mut TestBus { asks: true, ..TestBus::default() };
    assert_eq!(core.run(bus, u64::MAX), Ok(Stop::Attention));
    assert_eq!((core.pc(), core.clock.now), (4, 2));
}

#[test]
fn sreg_keeps_a_sign_that_a_program_writes() {
    // OUT SREG, r16; IN r17, SREG; CP r16, r16; IN r18, SREG
    let mut core = core(&[0xBF0F, 0xB71F, 0x1700, 0xB72F]);
    core.registers[16] = 0x7F;
    core.run(&mut NoPeripherals::default(), 4).expect("four instructions");
    assert_eq!(core.registers[17..19], [0x7F, 0x42]);
}

#[test]
fn a_stack_outside_of_the_sram_uses_the_bus() {
    // PUSH r16; RCALL .+0; RET
    let mut core = core(&[0x930F, 0xD000, 0x9508]);
    core.registers[16] = 7;
    core.sp = 0x0100;
    let bus = &mut TestBus::default();
    core.run(bus, 5).expect("PUSH and RCALL");
    assert_eq!((core.ram()[0], bus.io.io[0xFF], bus.io.io[0xFE]), (7, 2, 0));
    core.run(bus, 9).expect("RET");
    assert_eq!((core.pc(), core.sp, bus.reads), (4, 0x00FF, 2));
}
