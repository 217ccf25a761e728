//! The table that the core executes: four bytes for each instruction, with masks and addresses as
//! the execution needs them.

use crate::opcode::{FLAG_C, FLAG_I, FLAG_N, FLAG_Z};
use crate::opcode::{Immediate, Mode, One, Op as Instruction, Pointer, Product, Two};

/// An instruction. Section 5 of DS40002198 has each by its name. The operands are `a` and `b` of
/// [`Entry`]: `d`, `r` register numbers, `k` constant, `m` mask of one bit, `io` data address,
/// `rel` distance in words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Op {
    Nop,
    Movw,
    Muls,
    Mulsu,
    Fmul,
    Fmuls,
    Fmulsu,
    Cpc,
    Sbc,
    Add,
    Cpse,
    Cp,
    Sub,
    Adc,
    And,
    Eor,
    Or,
    Mov,
    Mul,
    Cpi,
    Sbci,
    Subi,
    Ori,
    Andi,
    Ldi,
    /// LD and LDD without a change of the pointer: `d`, displacement.
    LoadX,
    LoadY,
    LoadZ,
    StoreX,
    StoreY,
    StoreZ,
    /// LD and ST with a change of the pointer: `d`, the pointer's low register.
    LoadIncrement,
    LoadDecrement,
    StoreIncrement,
    StoreDecrement,
    Lds,
    Sts,
    /// LPM without operands has `d` 0.
    Lpm,
    LpmIncrement,
    Spm,
    Push,
    Pop,
    Com,
    Neg,
    Swap,
    Inc,
    Dec,
    Asr,
    Lsr,
    Ror,
    /// `m`. All flags but I, which [`Op::Sei`] and [`Op::Cli`] change.
    Bset,
    Bclr,
    Sei,
    Cli,
    Ijmp,
    Icall,
    Ret,
    Reti,
    Sleep,
    Break,
    Wdr,
    /// No instruction of these chips.
    Invalid,
    Jmp,
    Call,
    Adiw,
    Sbiw,
    Cbi,
    Sbi,
    Sbic,
    Sbis,
    In,
    Out,
    Rjmp,
    Rcall,
    Brcs,
    Brcc,
    Breq,
    Brne,
    Brmi,
    Brpl,
    /// The branches by another flag: `m`, `rel`.
    Brbs,
    Brbc,
    Bld,
    Bst,
    Sbrc,
    Sbrs,
}

/// A decoded instruction and its operands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Entry {
    pub op: Op,
    pub a: u8,
    pub b: u16,
}

impl Entry {
    /// The entry of the words `first` and `second` of flash.
    pub fn new(first: u16, second: u16) -> Self {
        let of = Instruction::decode(first, second, 0);
        let (op, a, b) = of.map_or((Op::Invalid, 0, 0), operation);
        Self { op, a, b }
    }

    /// True for the instructions of two words.
    pub fn has_second_word(self) -> bool {
        matches!(self.op, Op::Lds | Op::Sts | Op::Jmp | Op::Call)
    }
}

/// First I/O register in the data space.
const IO: u16 = 0x20;

/// The operation of an instruction at address 0, and its operands.
fn operation(instruction: Instruction) -> (Op, u8, u16) {
    // The operation of the same name.
    macro_rules! same {
        ($kind:ident::$what:ident: $($name:ident)*) => {
            match $what { $($kind::$name => Op::$name),* }
        };
    }
    let io = |address: u8| IO + u16::from(address);
    let distance = |target: u32| (target.wrapping_sub(2) / 2) as u16;
    let word = |target: u32| (target / 2) as u16;
    match instruction {
        Instruction::Nop => (Op::Nop, 0, 0),
        Instruction::Movw(d, r) => (Op::Movw, d, r.into()),
        Instruction::Two(what, d, r) => {
            (same!(Two::what: Cpc Sbc Add Cp Sub Adc And Eor Or Mov), d, r.into())
        }
        Instruction::Cpse(d, r) => (Op::Cpse, d, r.into()),
        Instruction::Product(what, d, r) => {
            (same!(Product::what: Mul Muls Mulsu Fmul Fmuls Fmulsu), d, r.into())
        }
        Instruction::Immediate(what, d, k) => {
            (same!(Immediate::what: Cpi Sbci Subi Ori Andi Ldi), d, k.into())
        }
        Instruction::One(what, d) => (same!(One::what: Com Neg Swap Inc Asr Lsr Ror Dec), d, 0),
        Instruction::Adiw(d, k) => (Op::Adiw, d, k.into()),
        Instruction::Sbiw(d, k) => (Op::Sbiw, d, k.into()),
        Instruction::Load(d, pointer, mode) => match (mode, pointer) {
            (Mode::Displaced(_), Pointer::X) => (Op::LoadX, d, 0),
            (Mode::Displaced(q), Pointer::Y) => (Op::LoadY, d, q.into()),
            (Mode::Displaced(q), Pointer::Z) => (Op::LoadZ, d, q.into()),
            (Mode::PostIncrement, _) => (Op::LoadIncrement, d, pointer.low().into()),
            (Mode::PreDecrement, _) => (Op::LoadDecrement, d, pointer.low().into()),
        },
        Instruction::Store(r, pointer, mode) => match (mode, pointer) {
            (Mode::Displaced(_), Pointer::X) => (Op::StoreX, r, 0),
            (Mode::Displaced(q), Pointer::Y) => (Op::StoreY, r, q.into()),
            (Mode::Displaced(q), Pointer::Z) => (Op::StoreZ, r, q.into()),
            (Mode::PostIncrement, _) => (Op::StoreIncrement, r, pointer.low().into()),
            (Mode::PreDecrement, _) => (Op::StoreDecrement, r, pointer.low().into()),
        },
        Instruction::Lds(d, address) => (Op::Lds, d, address),
        Instruction::Sts(address, r) => (Op::Sts, r, address),
        Instruction::LpmR0 => (Op::Lpm, 0, 0),
        Instruction::Lpm(d, false) => (Op::Lpm, d, 0),
        Instruction::Lpm(d, true) => (Op::LpmIncrement, d, 0),
        Instruction::Spm => (Op::Spm, 0, 0),
        Instruction::Push(r) => (Op::Push, r, 0),
        Instruction::Pop(d) => (Op::Pop, d, 0),
        Instruction::In(d, address) => (Op::In, d, io(address)),
        Instruction::Out(address, r) => (Op::Out, r, io(address)),
        Instruction::Sbi(address, bit) => (Op::Sbi, 1 << bit, io(address)),
        Instruction::Cbi(address, bit) => (Op::Cbi, 1 << bit, io(address)),
        Instruction::Sbic(address, bit) => (Op::Sbic, 1 << bit, io(address)),
        Instruction::Sbis(address, bit) => (Op::Sbis, 1 << bit, io(address)),
        Instruction::Sbrc(r, bit) => (Op::Sbrc, r, 1 << bit),
        Instruction::Sbrs(r, bit) => (Op::Sbrs, r, 1 << bit),
        Instruction::Bld(d, bit) => (Op::Bld, d, 1 << bit),
        Instruction::Bst(d, bit) => (Op::Bst, d, 1 << bit),
        Instruction::Bset(FLAG_I) => (Op::Sei, 0, 0),
        Instruction::Bset(flag) => (Op::Bset, 1 << flag, 0),
        Instruction::Bclr(FLAG_I) => (Op::Cli, 0, 0),
        Instruction::Bclr(flag) => (Op::Bclr, 1 << flag, 0),
        Instruction::Brbs(flag @ FLAG_C, target) => (Op::Brcs, 1 << flag, distance(target)),
        Instruction::Brbs(flag @ FLAG_Z, target) => (Op::Breq, 1 << flag, distance(target)),
        Instruction::Brbs(flag @ FLAG_N, target) => (Op::Brmi, 1 << flag, distance(target)),
        Instruction::Brbs(flag, target) => (Op::Brbs, 1 << flag, distance(target)),
        Instruction::Brbc(flag @ FLAG_C, target) => (Op::Brcc, 1 << flag, distance(target)),
        Instruction::Brbc(flag @ FLAG_Z, target) => (Op::Brne, 1 << flag, distance(target)),
        Instruction::Brbc(flag @ FLAG_N, target) => (Op::Brpl, 1 << flag, distance(target)),
        Instruction::Brbc(flag, target) => (Op::Brbc, 1 << flag, distance(target)),
        Instruction::Rjmp(target) => (Op::Rjmp, 0, distance(target)),
        Instruction::Rcall(target) => (Op::Rcall, 0, distance(target)),
        Instruction::Jmp(target) => (Op::Jmp, 0, word(target)),
        Instruction::Call(target) => (Op::Call, 0, word(target)),
        Instruction::Ijmp => (Op::Ijmp, 0, 0),
        Instruction::Icall => (Op::Icall, 0, 0),
        Instruction::Ret => (Op::Ret, 0, 0),
        Instruction::Reti => (Op::Reti, 0, 0),
        Instruction::Sleep => (Op::Sleep, 0, 0),
        Instruction::Break => (Op::Break, 0, 0),
        Instruction::Wdr => (Op::Wdr, 0, 0),
    }
}
