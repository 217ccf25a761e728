//! The decoder of instructions. crates/avr-bounds/tests/opcodes.rs compares it with avr-objdump for
//! each of the 65,536 first words.

use crate::opcode::{Immediate, Mode, One, Op, Pointer, Product, Two};

impl Op {
    /// Decodes the instruction at byte address `at`. `second` is the word behind `first`. `None`:
    /// this core has no such instruction.
    pub fn decode(first: u16, second: u16, at: u32) -> Option<Self> {
        let w = first;
        Some(match w >> 12 {
            0x0 => return decode_0(w),
            0x1..=0x2 => two(w),
            0x3 => immediate(Immediate::Cpi, w),
            0x4 => immediate(Immediate::Sbci, w),
            0x5 => immediate(Immediate::Subi, w),
            0x6 => immediate(Immediate::Ori, w),
            0x7 => immediate(Immediate::Andi, w),
            0x8 | 0xA => displaced(w),
            0x9 => return decode_9(w, second),
            0xB => {
                let io = ((w >> 5 & 0x30) | (w & 0x0F)) as u8;
                if w & 0x0800 == 0 { Self::In(d5(w), io) } else { Self::Out(io, d5(w)) }
            }
            0xC => Self::Rjmp(relative(at, w, 12)),
            0xD => Self::Rcall(relative(at, w, 12)),
            0xE => immediate(Immediate::Ldi, w),
            _ => return decode_f(w, at),
        })
    }
}

/// Bits 8 to 4: register d.
fn d5(w: u16) -> u8 {
    (w >> 4 & 0x1F) as u8
}

/// Bit 9 and bits 3 to 0: register r.
fn r5(w: u16) -> u8 {
    ((w >> 5 & 0x10) | (w & 0x0F)) as u8
}

/// The target of a relative jump of `bits` bits.
fn relative(at: u32, offset: u16, bits: u32) -> u32 {
    let shift = 16 - bits;
    let words = ((offset << shift) as i16) >> shift;
    at.wrapping_add(2).wrapping_add_signed(i32::from(words) * 2)
}

fn immediate(what: Immediate, w: u16) -> Op {
    Op::Immediate(what, 16 + (w >> 4 & 0x0F) as u8, ((w >> 4 & 0xF0) | (w & 0x0F)) as u8)
}

fn decode_0(w: u16) -> Option<Op> {
    let (d3, r3) = (16 + (w >> 4 & 7) as u8, 16 + (w & 7) as u8);
    let (d4, r4) = ((w >> 4 & 0x0F) as u8, (w & 0x0F) as u8);
    Some(match w >> 8 {
        0 if w == 0 => Op::Nop,
        0 => return None,
        1 => Op::Movw(d4 * 2, r4 * 2),
        2 => Op::Product(Product::Muls, 16 + d4, 16 + r4),
        3 => {
            let what = match w & 0x88 {
                0x00 => Product::Mulsu,
                0x08 => Product::Fmul,
                0x80 => Product::Fmuls,
                _ => Product::Fmulsu,
            };
            Op::Product(what, d3, r3)
        }
        _ => two(w),
    })
}

/// The two-register operations: 0x0400 to 0x2FFF.
fn two(w: u16) -> Op {
    let what = match w >> 10 {
        1 => Two::Cpc,
        2 => Two::Sbc,
        3 => Two::Add,
        4 => return Op::Cpse(d5(w), r5(w)),
        5 => Two::Cp,
        6 => Two::Sub,
        7 => Two::Adc,
        8 => Two::And,
        9 => Two::Eor,
        10 => Two::Or,
        _ => Two::Mov,
    };
    Op::Two(what, d5(w), r5(w))
}

/// LDD and STD: the displacement is in bits 13, 11, 10 and 2 to 0.
fn displaced(w: u16) -> Op {
    let q = ((w >> 8 & 0x20) | (w >> 7 & 0x18) | (w & 7)) as u8;
    let pointer = if w & 8 != 0 { Pointer::Y } else { Pointer::Z };
    let mode = Mode::Displaced(q);
    if w & 0x0200 == 0 { Op::Load(d5(w), pointer, mode) } else { Op::Store(d5(w), pointer, mode) }
}

fn decode_9(w: u16, second: u16) -> Option<Op> {
    let pair = 24 + 2 * (w >> 4 & 3) as u8;
    let k6 = ((w >> 2 & 0x30) | (w & 0x0F)) as u8;
    let (io, bit) = ((w >> 3 & 0x1F) as u8, (w & 7) as u8);
    Some(match w >> 8 & 0x0F {
        0x0 | 0x1 => return load(w, second),
        0x2 | 0x3 => return store(w, second),
        0x4 | 0x5 => return decode_94(w, second),
        0x6 => Op::Adiw(pair, k6),
        0x7 => Op::Sbiw(pair, k6),
        0x8 => Op::Cbi(io, bit),
        0x9 => Op::Sbic(io, bit),
        0xA => Op::Sbi(io, bit),
        0xB => Op::Sbis(io, bit),
        _ => Op::Product(Product::Mul, d5(w), r5(w)),
    })
}

/// Pointer and mode of LD and ST with a changed pointer, and of X.
fn pointed(w: u16) -> Option<(Pointer, Mode)> {
    Some(match w & 0x0F {
        0x1 => (Pointer::Z, Mode::PostIncrement),
        0x2 => (Pointer::Z, Mode::PreDecrement),
        0x9 => (Pointer::Y, Mode::PostIncrement),
        0xA => (Pointer::Y, Mode::PreDecrement),
        0xC => (Pointer::X, Mode::Displaced(0)),
        0xD => (Pointer::X, Mode::PostIncrement),
        0xE => (Pointer::X, Mode::PreDecrement),
        _ => return None,
    })
}

fn load(w: u16, second: u16) -> Option<Op> {
    Some(match w & 0x0F {
        0x0 => Op::Lds(d5(w), second),
        0x4 => Op::Lpm(d5(w), false),
        0x5 => Op::Lpm(d5(w), true),
        0xF => Op::Pop(d5(w)),
        _ => {
            let (pointer, mode) = pointed(w)?;
            Op::Load(d5(w), pointer, mode)
        }
    })
}

fn store(w: u16, second: u16) -> Option<Op> {
    Some(match w & 0x0F {
        0x0 => Op::Sts(second, d5(w)),
        0xF => Op::Push(d5(w)),
        _ => {
            let (pointer, mode) = pointed(w)?;
            Op::Store(d5(w), pointer, mode)
        }
    })
}

fn decode_94(w: u16, second: u16) -> Option<Op> {
    let one = |what| Some(Op::One(what, d5(w)));
    // Bits 21 to 16 of a word address. The bytes must fit in 32 bits, which 22 bits of words do.
    let far = (u32::from(w >> 3 & 0x3E | w & 1) << 16 | u32::from(second)) * 2;
    match w & 0x0F {
        0x0 => one(One::Com),
        0x1 => one(One::Neg),
        0x2 => one(One::Swap),
        0x3 => one(One::Inc),
        0x5 => one(One::Asr),
        0x6 => one(One::Lsr),
        0x7 => one(One::Ror),
        0x8 => decode_fixed(w),
        0x9 => match w {
            0x9409 => Some(Op::Ijmp),
            0x9509 => Some(Op::Icall),
            _ => None,
        },
        0xA => one(One::Dec),
        0xC | 0xD => Some(Op::Jmp(far)),
        0xE | 0xF => Some(Op::Call(far)),
        _ => None,
    }
}

/// The instructions without operands, and those that set and clear flags.
fn decode_fixed(w: u16) -> Option<Op> {
    Some(match w {
        0x9508 => Op::Ret,
        0x9518 => Op::Reti,
        0x9588 => Op::Sleep,
        0x9598 => Op::Break,
        0x95A8 => Op::Wdr,
        0x95C8 => Op::LpmR0,
        0x95E8 => Op::Spm,
        _ if w & 0x0100 != 0 => return None,
        _ if w & 0x80 == 0 => Op::Bset((w >> 4 & 7) as u8),
        _ => Op::Bclr((w >> 4 & 7) as u8),
    })
}

fn decode_f(w: u16, at: u32) -> Option<Op> {
    let bit = (w & 7) as u8;
    if w & 0x0800 == 0 {
        let target = relative(at, w >> 3 & 0x7F, 7);
        return Some(if w & 0x0400 == 0 { Op::Brbs(bit, target) } else { Op::Brbc(bit, target) });
    }
    if w & 8 != 0 {
        return None;
    }
    Some(match w >> 9 & 3 {
        0 => Op::Bld(d5(w), bit),
        1 => Op::Bst(d5(w), bit),
        2 => Op::Sbrc(d5(w), bit),
        _ => Op::Sbrs(d5(w), bit),
    })
}
