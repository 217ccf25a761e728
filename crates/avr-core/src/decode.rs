//! The decoder: two words of flash to an entry of the table that the core executes.
//!
//! It is not the one of `avr-bounds`, whose nested values suit an analysis: the table has
//! four bytes an entry, with masks and addresses as the execution needs them.

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
    /// True for the instructions of two words.
    pub fn has_second_word(self) -> bool {
        matches!(self.op, Op::Lds | Op::Sts | Op::Jmp | Op::Call)
    }
}

/// First I/O register in the data space.
const IO: u16 = 0x20;

/// Decodes the instruction `w`; `second` is the word behind it.
pub(crate) fn decode(w: u16, second: u16) -> Entry {
    // Bits 8 to 4: register d. Bit 9 and bits 3 to 0: register r.
    let d5 = (w >> 4 & 0x1F) as u8;
    let r5 = w >> 5 & 0x10 | w & 0x0F;
    let d4 = 16 + (w >> 4 & 0x0F) as u8;
    let k8 = w >> 4 & 0xF0 | w & 0x0F;
    let bit = 1 << (w & 7);
    // Bits 11 to 0 of RJMP and RCALL, bits 9 to 3 of the branches, with their sign.
    let far = ((w << 4) as i16 >> 4) as u16;
    let near = ((w << 6) as i16 >> 9) as u16;
    let io5 = IO + (w >> 3 & 0x1F);
    let io6 = IO + (w >> 5 & 0x30 | w & 0x0F);
    let (op, a, b) = match w >> 10 {
        0x00 => low(w),
        0x01 => (Op::Cpc, d5, r5),
        0x02 => (Op::Sbc, d5, r5),
        0x03 => (Op::Add, d5, r5),
        0x04 => (Op::Cpse, d5, r5),
        0x05 => (Op::Cp, d5, r5),
        0x06 => (Op::Sub, d5, r5),
        0x07 => (Op::Adc, d5, r5),
        0x08 => (Op::And, d5, r5),
        0x09 => (Op::Eor, d5, r5),
        0x0A => (Op::Or, d5, r5),
        0x0B => (Op::Mov, d5, r5),
        0x0C..=0x0F => (Op::Cpi, d4, k8),
        0x10..=0x13 => (Op::Sbci, d4, k8),
        0x14..=0x17 => (Op::Subi, d4, k8),
        0x18..=0x1B => (Op::Ori, d4, k8),
        0x1C..=0x1F => (Op::Andi, d4, k8),
        0x20..=0x23 | 0x28..=0x2B => {
            let displacement = w >> 8 & 0x20 | w >> 7 & 0x18 | w & 7;
            let op = match (w & 0x0200 != 0, w & 8 != 0) {
                (false, false) => Op::LoadZ,
                (false, true) => Op::LoadY,
                (true, false) => Op::StoreZ,
                (true, true) => Op::StoreY,
            };
            (op, d5, displacement)
        }
        0x24 => memory(w, d5, second),
        0x25 if w & 0x0200 == 0 => one_operand(w, d5, second),
        0x25 => {
            let op = if w & 0x0100 == 0 { Op::Adiw } else { Op::Sbiw };
            (op, 24 + 2 * (w >> 4 & 3) as u8, w >> 2 & 0x30 | w & 0x0F)
        }
        0x26 => {
            let (bit_op, skip) =
                if w & 0x0200 == 0 { (Op::Cbi, Op::Sbic) } else { (Op::Sbi, Op::Sbis) };
            (if w & 0x0100 == 0 { bit_op } else { skip }, bit, io5)
        }
        0x27 => (Op::Mul, d5, r5),
        0x2C..=0x2F => (if w & 0x0800 == 0 { Op::In } else { Op::Out }, d5, io6),
        0x30..=0x33 => (Op::Rjmp, 0, far),
        0x34..=0x37 => (Op::Rcall, 0, far),
        0x38..=0x3B => (Op::Ldi, d4, k8),
        0x3C | 0x3D => {
            let op = match (w & 7, w & 0x0400 == 0) {
                (0, true) => Op::Brcs,
                (0, false) => Op::Brcc,
                (1, true) => Op::Breq,
                (1, false) => Op::Brne,
                (2, true) => Op::Brmi,
                (2, false) => Op::Brpl,
                (_, true) => Op::Brbs,
                (_, false) => Op::Brbc,
            };
            (op, bit, near)
        }
        _ if w & 8 != 0 => (Op::Invalid, 0, 0),
        0x3E => (if w & 0x0200 == 0 { Op::Bld } else { Op::Bst }, d5, bit.into()),
        _ => (if w & 0x0200 == 0 { Op::Sbrc } else { Op::Sbrs }, d5, bit.into()),
    };
    Entry { op, a, b }
}

/// 0x0000 to 0x03FF: NOP, MOVW and the multiplications of the upper registers.
fn low(w: u16) -> (Op, u8, u16) {
    let (d3, r3) = (16 + (w >> 4 & 7) as u8, 16 + (w & 7));
    match w >> 8 {
        0 if w == 0 => (Op::Nop, 0, 0),
        0 => (Op::Invalid, 0, 0),
        1 => (Op::Movw, (w >> 4 & 0x0F) as u8 * 2, (w & 0x0F) * 2),
        2 => (Op::Muls, 16 + (w >> 4 & 0x0F) as u8, 16 + (w & 0x0F)),
        _ => match w & 0x88 {
            0x00 => (Op::Mulsu, d3, r3),
            0x08 => (Op::Fmul, d3, r3),
            0x80 => (Op::Fmuls, d3, r3),
            _ => (Op::Fmulsu, d3, r3),
        },
    }
}

/// 0x9000 to 0x93FF: loads and stores. XCH, LAS, LAC and LAT (0x9204 to 0x9207) and ELPM (0x9006,
/// 0x9007) do not exist.
fn memory(w: u16, d: u8, second: u16) -> (Op, u8, u16) {
    const X: u16 = 26;
    const Y: u16 = 28;
    const Z: u16 = 30;
    match w & 0x020F {
        0x000 => (Op::Lds, d, second),
        0x001 => (Op::LoadIncrement, d, Z),
        0x002 => (Op::LoadDecrement, d, Z),
        0x004 => (Op::Lpm, d, 0),
        0x005 => (Op::LpmIncrement, d, 0),
        0x009 => (Op::LoadIncrement, d, Y),
        0x00A => (Op::LoadDecrement, d, Y),
        0x00C => (Op::LoadX, d, 0),
        0x00D => (Op::LoadIncrement, d, X),
        0x00E => (Op::LoadDecrement, d, X),
        0x00F => (Op::Pop, d, 0),
        0x200 => (Op::Sts, d, second),
        0x201 => (Op::StoreIncrement, d, Z),
        0x202 => (Op::StoreDecrement, d, Z),
        0x209 => (Op::StoreIncrement, d, Y),
        0x20A => (Op::StoreDecrement, d, Y),
        0x20C => (Op::StoreX, d, 0),
        0x20D => (Op::StoreIncrement, d, X),
        0x20E => (Op::StoreDecrement, d, X),
        0x20F => (Op::Push, d, 0),
        _ => (Op::Invalid, 0, 0),
    }
}

/// 0x9400 to 0x95FF. EIJMP, EICALL, ELPM, DES and SPM Z+ do not exist.
fn one_operand(w: u16, d: u8, second: u16) -> (Op, u8, u16) {
    let flag = 1 << (w >> 4 & 7);
    match w & 0x0F {
        0x0 => (Op::Com, d, 0),
        0x1 => (Op::Neg, d, 0),
        0x2 => (Op::Swap, d, 0),
        0x3 => (Op::Inc, d, 0),
        0x5 => (Op::Asr, d, 0),
        0x6 => (Op::Lsr, d, 0),
        0x7 => (Op::Ror, d, 0),
        0xA => (Op::Dec, d, 0),
        0xC | 0xD => (Op::Jmp, 0, second),
        0xE | 0xF => (Op::Call, 0, second),
        _ => match w {
            0x9409 => (Op::Ijmp, 0, 0),
            0x9509 => (Op::Icall, 0, 0),
            0x9478 => (Op::Sei, 0, 0),
            0x94F8 => (Op::Cli, 0, 0),
            0x9508 => (Op::Ret, 0, 0),
            0x9518 => (Op::Reti, 0, 0),
            0x9588 => (Op::Sleep, 0, 0),
            0x9598 => (Op::Break, 0, 0),
            0x95A8 => (Op::Wdr, 0, 0),
            0x95C8 => (Op::Lpm, 0, 0),
            0x95E8 => (Op::Spm, 0, 0),
            _ if w & 0xFF8F == 0x9408 => (Op::Bset, flag, 0),
            _ if w & 0xFF8F == 0x9488 => (Op::Bclr, flag, 0),
            _ => (Op::Invalid, 0, 0),
        },
    }
}
