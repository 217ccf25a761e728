//! Compares simavr's processor with the one of `avr-core` and with avr8js's, instruction by
//! instruction: registers, SREG, stack pointer, program counter and cycles, for all opcodes with
//! random operands and flags.
//!
//! `avr-core` runs beside simavr from the same start, and the SRAM and the I/O registers are equal
//! at the end. No difference is left.
//!
//! avr8js gets the state before each instruction from simavr, so that one difference has no
//! further ones. Both keep their own SRAM, which later loads compare.
//!
//! `opcodes.cjs` knows where avr8js is wrong by the manual of the instruction set; there simavr
//! must agree with the manual. opcodes.cjs names these places.
//!
//! The test needs Node.js and avr8js, from `web/node_modules` or from the directory in AVR8JS:
//!
//! ```sh
//! AVR8JS=.../node_modules/avr8js cargo test -p bench --test all -- opcodes:: --ignored --nocapture
//! ```
//!
//! Not compared: SPM, SLEEP, BREAK, and what the instruction set manual calls undefined: LD and ST
//! of a pointer's own half with increment or decrement.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Command;

use avr_core::{Core, NoPeripherals};
use bench::avr::{Avr, Chip, Registers, ResetCause, Resume};
use bench::{Cycles, Noise, target_dir};

const SEEDS: u64 = 8;
const BLOCKS: usize = 4_000;
/// Byte addresses of the SRAM that loads and stores use. The stack is above.
const RAM: std::ops::Range<u16> = 0x0180..0x0700;
const STACK: u16 = 0x08FF;

/// A program under construction, as words.
struct Program {
    words: Vec<u16>,
    noise: Noise,
}

impl Program {
    fn below(&mut self, limit: u16) -> u16 {
        (self.noise.next_u64() % u64::from(limit)) as u16
    }

    fn word(&mut self, word: u16) {
        self.words.push(word);
    }

    fn ldi(&mut self, register: u16, value: u16) {
        self.word(0xE000 | (value & 0xF0) << 4 | (register - 16) << 4 | value & 0xF);
    }

    /// Loads a pointer: X (26), Y (28) or Z (30).
    fn point(&mut self, register: u16, address: u16) {
        self.ldi(register, address & 0xFF);
        self.ldi(register + 1, address >> 8);
    }

    fn ram(&mut self) -> u16 {
        // A pointer also reaches the registers.
        if self.below(16) == 0 {
            self.below(24)
        } else {
            RAM.start + 64 + self.below(RAM.end - RAM.start - 128)
        }
    }

    /// An instruction of one or two words that a skip can skip.
    fn skipped(&mut self) {
        let register = self.below(32);
        if self.below(2) == 0 {
            self.word(0x9403 | register << 4);
        } else {
            let address = RAM.start + self.below(RAM.end - RAM.start);
            self.word(0x9000 | register << 4);
            self.word(address);
        }
    }

    /// The address of the next word but `ahead`, in words.
    fn next(&self, ahead: u16) -> u16 {
        self.words.len() as u16 + ahead
    }

    /// A random instruction, with what it needs before and behind it.
    fn block(&mut self) {
        let (d, r) = (self.below(32), self.below(32));
        let (high, immediate, bit) = (self.below(16), self.below(256), self.below(8));
        if self.below(3) == 0 {
            // OUT SREG: all flags but I, which the bit instructions set.
            let flags = self.below(128);
            self.ldi(16, flags);
            self.word(0xBF0F);
        }
        let two = |opcode: u16| opcode | (r & 16) << 5 | d << 4 | r & 15;
        let with = |opcode: u16| opcode | (immediate & 0xF0) << 4 | high << 4 | immediate & 0xF;
        match self.below(34) {
            0..5 => {
                // CPC, SBC, ADD, CP, SUB, ADC, AND, EOR, OR, MOV, MUL
                let opcodes = [
                    0x0400, 0x0800, 0x0C00, 0x1400, 0x1800, 0x1C00, 0x2000, 0x2400, 0x2800, 0x2C00,
                    0x9C00,
                ];
                let opcode = opcodes[usize::from(self.below(11))];
                self.word(two(opcode));
            }
            5..8 => {
                // CPI, SBCI, SUBI, ORI, ANDI, LDI
                let opcodes = [0x3000, 0x4000, 0x5000, 0x6000, 0x7000, 0xE000];
                let opcode = opcodes[usize::from(self.below(6))];
                self.word(with(opcode));
            }
            8..11 => {
                // COM, NEG, SWAP, INC, ASR, LSR, ROR, DEC
                let opcodes = [0, 1, 2, 3, 5, 6, 7, 10];
                let opcode = opcodes[usize::from(self.below(8))];
                self.word(0x9400 | d << 4 | opcode);
            }
            // ADIW, SBIW
            11 => self.word(0x9600 | immediate & 0xF | (high & 3) << 4 | (immediate & 0x30) << 2),
            12 => self.word(0x9700 | immediate & 0xF | (high & 3) << 4 | (immediate & 0x30) << 2),
            // MOVW, MULS
            13 => self.word(0x0100 | high << 4 | immediate & 0xF),
            14 => self.word(0x0200 | high << 4 | immediate & 0xF),
            // MULSU, FMUL, FMULS, FMULSU
            15 => self.word(0x0300 | (immediate & 0x88) | (high & 7) << 4 | immediate & 7),
            // BSET, BCLR
            16 => self.word(0x9408 | bit << 4 | (high & 1) << 7),
            // BLD, BST
            17 => self.word(0xF800 | (high & 1) << 9 | d << 4 | bit),
            18 => {
                // SBRC, SBRS, CPSE
                let skip =
                    if high < 10 { 0xFC00 | (high & 1) << 9 | d << 4 | bit } else { two(0x1000) };
                self.word(skip);
                self.skipped();
            }
            19 => {
                // SBIC, SBIS of GPIOR0
                self.word(0x9900 | (high & 1) << 9 | 0x1E << 3 | bit);
                self.skipped();
            }
            // CBI, SBI of GPIOR0
            20 => self.word(0x9800 | (high & 1) << 9 | 0x1E << 3 | bit),
            21 => {
                // OUT and IN of GPIOR0, GPIOR1, GPIOR2, and IN of SREG
                let address = [0x1E, 0x2A, 0x2B][usize::from(high % 3)];
                self.word(0xB800 | (address & 0x30) << 5 | d << 4 | address & 0xF);
                let address = if high > 11 { 0x3F } else { address };
                self.word(0xB000 | (address & 0x30) << 5 | r << 4 | address & 0xF);
            }
            22 => {
                // BRBS, BRBC over two instructions
                self.word(0xF000 | (high & 1) << 10 | 2 << 3 | bit);
                self.word(0x9403 | d << 4);
                self.word(0x9403 | r << 4);
            }
            23 => {
                // RJMP, JMP over an instruction
                if high & 1 == 0 {
                    self.word(0xC001);
                } else {
                    let target = self.next(3);
                    self.word(0x940C);
                    self.word(target);
                }
                self.word(0x9403 | d << 4);
            }
            24 => {
                // RCALL, CALL, ICALL of what follows, and POP of the return address
                let target = self.next(2);
                match high % 3 {
                    0 => self.word(0xD000),
                    1 => {
                        self.word(0x940E);
                        self.word(target);
                    }
                    _ => {
                        self.point(30, target + 1);
                        self.word(0x9509);
                    }
                }
                self.word(0x900F | d << 4);
                self.word(0x900F | r << 4);
            }
            25 => {
                // IJMP
                let target = self.next(3);
                self.point(30, target);
                self.word(0x9409);
            }
            26 => {
                // RET, RETI
                let target = self.next(5);
                self.ldi(16, target & 0xFF);
                self.word(0x920F | 16 << 4);
                self.ldi(16, target >> 8);
                self.word(0x920F | 16 << 4);
                self.word(if high & 1 == 0 { 0x9508 } else { 0x9518 });
            }
            27 => {
                // PUSH, POP
                self.word(0x920F | d << 4);
                self.word(0x900F | r << 4);
            }
            28 => {
                // LDS, STS
                let address = self.ram();
                self.word(0x9000 | (high & 1) << 9 | d << 4);
                self.word(address);
            }
            29 => {
                // LPM, LPM Z, LPM Z+
                let address = self.below(0x8000);
                self.point(30, address);
                match high % 3 {
                    0 => self.word(0x95C8),
                    1 => self.word(0x9004 | d << 4),
                    _ => self.word(0x9005 | (d % 30) << 4),
                }
            }
            30 => {
                // LDD, STD of Y and Z with a displacement, which must not reach the I/O registers
                let address = self.ram().max(RAM.start);
                let (pointer, q) = (28 + (high & 2), self.below(64));
                self.point(pointer, address);
                let opcode = 0x8000 | (q & 32) << 8 | (q & 24) << 7 | q & 7;
                let y = if pointer == 28 { 8 } else { 0 };
                self.word(opcode | (high & 1) << 9 | d << 4 | y);
            }
            31 => {
                // LD, ST: X, X+, -X, Y+, -Y, Z+, -Z
                let address = self.ram().max(1);
                let modes = [(26, 12), (26, 13), (26, 14), (28, 9), (28, 10), (30, 1), (30, 2)];
                let (pointer, mode) = modes[usize::from(self.below(7))];
                self.point(pointer, address);
                let own = mode != 12 && (pointer..pointer + 2).contains(&d);
                let d = if own { 0 } else { d };
                self.word(0x9000 | (high & 1) << 9 | d << 4 | mode);
            }
            // NOP, WDR
            32 => self.word(0),
            _ => self.word(0x95A8),
        }
    }
}

/// The program of a seed: registers and pointer first, RJMP to itself last.
fn program(seed: u64) -> Vec<u16> {
    let mut program = Program { words: Vec::new(), noise: Noise::new(seed) };
    for register in 0..32 {
        let value = program.below(256);
        program.ldi(16, value);
        program.word(0x2C00 | 16 << 5 | register << 4);
    }
    for (address, byte) in [(0x3D, STACK & 0xFF), (0x3E, STACK >> 8), (0x1E, 0), (0x2A, 0)] {
        program.ldi(16, byte);
        program.word(0xB800 | (address & 0x30) << 5 | 16 << 4 | address & 0xF);
    }
    while program.words.len() < BLOCKS * 3 {
        program.block();
    }
    program.word(0xCFFF);
    program.words
}

fn line(registers: &Registers, cycles: u64) -> String {
    let mut line = String::new();
    for register in registers.r {
        write!(line, "{register:02x}").expect("a string");
    }
    let Registers { sreg, sp, pc, .. } = registers;
    write!(line, " {sreg:02x} {sp:04x} {pc:04x} {cycles}").expect("a string");
    line
}

/// A chip in simavr with a program and an SRAM of zeros.
fn simavr(bytes: &[u8]) -> Avr {
    let mut avr = Avr::blank(Chip::Atmega328p).expect("a chip");
    avr.load_flash(0, bytes);
    avr.reset(ResetCause::PowerOn);
    for address in 0x0100..=Chip::Atmega328p.ram_end() {
        avr.poke_sram(address, 0);
    }
    avr
}

fn to_bytes(words: &[u16]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

fn registers_of(core: &Core) -> Registers {
    Registers { r: core.registers, sreg: core.sreg, sp: core.sp, pc: core.pc() }
}

/// Runs a program on simavr. `look` gets its state before each instruction. Returns it at its end.
fn run(words: &[u16], mut look: impl FnMut(&Registers, Cycles)) -> Avr {
    let mut avr = simavr(&to_bytes(words));
    let end = 2 * (words.len() as u32 - 1);
    let debugger = avr.debugger();
    // No program has loops.
    for _ in 0..words.len() {
        let registers = debugger.registers();
        look(&registers, avr.now());
        if registers.pc == end {
            return avr;
        }
        debugger.resume(Resume::Step);
        avr.run_until(avr.now() + 100);
        assert!(!debugger.has_crashed(), "crashed after {registers:x?}");
    }
    panic!("the program does not end");
}

/// Runs a program on simavr and on `avr-core` side by side. Returns the number of instructions.
fn compare_with_own_core(seed: u64) -> usize {
    let words = program(seed);
    let mut core = Core::new(avr_core::Chip::ATmega328P);
    core.write_flash(0, &to_bytes(&words));
    let mut io = NoPeripherals::default();
    let (mut executed, mut start) = (0, 0);
    let mut avr = run(&words, |registers, now| {
        let before = registers_of(&core);
        if executed == 0 {
            core.registers = registers.r;
            start = now;
        } else {
            core.step(&mut io).expect("an instruction");
        }
        let opcode = words[before.pc as usize / 2];
        assert_eq!(
            (&registers_of(&core), core.clock.now),
            (registers, now - start),
            "seed {seed}, opcode {opcode:#06x} after {before:x?}"
        );
        executed += 1;
    });
    assert_eq!(core.ram(), avr.sram_range(0x0100..=Chip::Atmega328p.ram_end()));
    for address in [0x3E, 0x4A, 0x4B] {
        let simavr = avr.debugger().data(address);
        assert_eq!(simavr, Some(io.io[address as usize]), "I/O register {address:#x}");
    }
    executed
}

/// The states of simavr before each instruction of a program.
fn trace(words: &[u16]) -> String {
    let mut lines = String::new();
    run(words, |registers, now| lines += &(line(registers, now) + "\n"));
    lines
}

/// The differences of avr8js for one seed, a line each: mnemonic, what differs, and an example.
fn differences(seed: u64, directory: &Path) -> Vec<String> {
    let words = program(seed);
    let (flash, states) = (directory.join("opcodes.bin"), directory.join("opcodes.trace"));
    fs::write(&flash, to_bytes(&words)).expect("a file");
    fs::write(&states, trace(&words)).expect("a file");
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let output = Command::new("node")
        .arg(root.join("sim/bench/tests/opcodes.cjs"))
        .arg(std::env::var_os("AVR8JS").unwrap_or(root.join("web/node_modules/avr8js").into()))
        .args([flash, states])
        .output()
        .expect("Node.js starts");
    let (out, error) = (output.stdout, String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{error}");
    eprint!("seed {seed}: {error}");
    String::from_utf8(out).expect("text").lines().map(str::to_owned).collect()
}

#[test]
fn avr_core_and_simavr_execute_each_instruction_alike() {
    let executed: usize = (0..SEEDS).map(compare_with_own_core).sum();
    assert!(executed > 50_000, "only {executed} instructions");
}

#[test]
#[ignore = "needs Node.js and avr8js"]
fn simavr_and_avr8js_execute_each_instruction_alike() {
    let directory = target_dir().join("tmp");
    fs::create_dir_all(&directory).expect("a directory");
    let all: Vec<String> = (0..SEEDS).flat_map(|seed| differences(seed, &directory)).collect();
    assert!(all.is_empty(), "{}", all.join("\n"));
}
