//! The instructions of the classic AVR core with multiplier (AVRe+).
//!
//! Source: the AVR instruction set manual (DS40002198). The chips have at most 128 KiB of flash, so
//! the program counter has two bytes, and EICALL, EIJMP, ELPM and the instructions of other cores
//! (XCH, LAS, LAC, LAT, DES, SPM Z+) do not exist.

/// A register pair that LD, ST, LDD and STD use as a pointer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Pointer {
    /// r27:r26.
    X,
    /// r29:r28.
    Y,
    /// r31:r30.
    Z,
}

impl Pointer {
    /// The lower register of the pair.
    pub fn low(self) -> u8 {
        match self {
            Self::X => 26,
            Self::Y => 28,
            Self::Z => 30,
        }
    }
}

/// How an access forms its address, and what it does to the pointer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Mode {
    /// The pointer and a displacement of 0 to 63.
    Displaced(u8),
    /// The pointer, which is then incremented.
    PostIncrement,
    /// The pointer after it is decremented.
    PreDecrement,
}

/// Two-register operation of the arithmetic unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Two {
    /// CPC: compare with carry.
    Cpc,
    /// SBC: subtract with carry.
    Sbc,
    /// ADD.
    Add,
    /// CP: compare.
    Cp,
    /// SUB.
    Sub,
    /// ADC: add with carry.
    Adc,
    /// AND.
    And,
    /// EOR.
    Eor,
    /// OR.
    Or,
    /// MOV.
    Mov,
}

/// Multiplication, with the result in r1:r0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Product {
    /// MUL: unsigned.
    Mul,
    /// MULS: signed.
    Muls,
    /// MULSU: signed with unsigned.
    Mulsu,
    /// FMUL: fractional unsigned.
    Fmul,
    /// FMULS: fractional signed.
    Fmuls,
    /// FMULSU: fractional signed with unsigned.
    Fmulsu,
}

/// Operation of a register and a constant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Immediate {
    /// CPI: compare.
    Cpi,
    /// SBCI: subtract with carry.
    Sbci,
    /// SUBI: subtract.
    Subi,
    /// ORI.
    Ori,
    /// ANDI.
    Andi,
    /// LDI: load.
    Ldi,
}

/// Operation of one register.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum One {
    /// COM: one's complement.
    Com,
    /// NEG: two's complement.
    Neg,
    /// SWAP: exchange the nibbles.
    Swap,
    /// INC.
    Inc,
    /// ASR: arithmetic shift right.
    Asr,
    /// LSR: logical shift right.
    Lsr,
    /// ROR: rotate right through carry.
    Ror,
    /// DEC.
    Dec,
}

/// An instruction. Registers are numbers from 0 to 31, I/O addresses from 0 to 63, addresses of
/// flash in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Op {
    /// NOP.
    Nop,
    /// MOVW d, r: copies a pair.
    Movw(u8, u8),
    /// A two-register operation on d, r.
    Two(Two, u8, u8),
    /// CPSE d, r: skip if equal.
    Cpse(u8, u8),
    /// A multiplication of d, r.
    Product(Product, u8, u8),
    /// An operation on d and a constant.
    Immediate(Immediate, u8, u8),
    /// An operation on d.
    One(One, u8),
    /// ADIW d, k: adds to a pair.
    Adiw(u8, u8),
    /// SBIW d, k: subtracts from a pair.
    Sbiw(u8, u8),
    /// LD or LDD d.
    Load(u8, Pointer, Mode),
    /// ST or STD r.
    Store(u8, Pointer, Mode),
    /// LDS d, address.
    Lds(u8, u16),
    /// STS address, r.
    Sts(u16, u8),
    /// LPM d, Z; true if Z is incremented.
    Lpm(u8, bool),
    /// LPM without operands: loads r0.
    LpmR0,
    /// SPM.
    Spm,
    /// PUSH.
    Push(u8),
    /// POP.
    Pop(u8),
    /// IN d, I/O address.
    In(u8, u8),
    /// OUT I/O address, r.
    Out(u8, u8),
    /// SBI address, bit.
    Sbi(u8, u8),
    /// CBI address, bit.
    Cbi(u8, u8),
    /// SBIC address, bit: skip if the bit is 0.
    Sbic(u8, u8),
    /// SBIS address, bit: skip if the bit is 1.
    Sbis(u8, u8),
    /// SBRC r, bit: skip if the bit is 0.
    Sbrc(u8, u8),
    /// SBRS r, bit: skip if the bit is 1.
    Sbrs(u8, u8),
    /// BLD d, bit: loads the T flag into a bit.
    Bld(u8, u8),
    /// BST d, bit: stores a bit in the T flag.
    Bst(u8, u8),
    /// BSET: sets a flag of SREG.
    Bset(u8),
    /// BCLR: clears a flag of SREG.
    Bclr(u8),
    /// BRBS flag, target: branch if the flag is 1.
    Brbs(u8, u32),
    /// BRBC flag, target: branch if the flag is 0.
    Brbc(u8, u32),
    /// RJMP target.
    Rjmp(u32),
    /// RCALL target.
    Rcall(u32),
    /// JMP target.
    Jmp(u32),
    /// CALL target.
    Call(u32),
    /// IJMP: jumps to the word address in Z.
    Ijmp,
    /// ICALL: calls the word address in Z.
    Icall,
    /// RET.
    Ret,
    /// RETI.
    Reti,
    /// SLEEP.
    Sleep,
    /// BREAK.
    Break,
    /// WDR: resets the watchdog.
    Wdr,
}

/// Carry flag of SREG.
pub const FLAG_C: u8 = 0;
/// Zero flag.
pub const FLAG_Z: u8 = 1;
/// Negative flag.
pub const FLAG_N: u8 = 2;
/// Overflow flag of two's complement.
pub const FLAG_V: u8 = 3;
/// Sign flag, N xor V.
pub const FLAG_S: u8 = 4;
/// Half carry flag.
pub const FLAG_H: u8 = 5;
/// Bit for BLD and BST.
pub const FLAG_T: u8 = 6;
/// Global interrupt enable.
pub const FLAG_I: u8 = 7;

impl Op {
    /// Length in bytes: 2 or 4.
    pub fn bytes(self) -> u32 {
        match self {
            Self::Lds(..) | Self::Sts(..) | Self::Jmp(_) | Self::Call(_) => 4,
            _ => 2,
        }
    }

    /// Cycles of the instruction if it neither skips nor branches. An interrupt's own cycles and
    /// the halt of the core during SPM are not included.
    pub fn cycles(self) -> u32 {
        match self {
            Self::Call(_) | Self::Ret | Self::Reti => 4,
            Self::Rcall(_) | Self::Icall | Self::Jmp(_) | Self::Lpm(..) | Self::LpmR0 => 3,
            Self::Rjmp(_) | Self::Ijmp | Self::Push(_) | Self::Pop(_) => 2,
            Self::Load(..) | Self::Store(..) | Self::Lds(..) | Self::Sts(..) => 2,
            Self::Adiw(..) | Self::Sbiw(..) | Self::Product(..) => 2,
            Self::Sbi(..) | Self::Cbi(..) => 2,
            _ => 1,
        }
    }

    /// True if the instruction can skip the next one.
    pub fn is_skip(self) -> bool {
        matches!(
            self,
            Self::Cpse(..) | Self::Sbic(..) | Self::Sbis(..) | Self::Sbrc(..) | Self::Sbrs(..)
        )
    }
}
