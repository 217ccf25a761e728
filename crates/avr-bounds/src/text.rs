//! The text of an instruction, as avr-objdump writes it.

use std::fmt;

use crate::opcode::{Mode, Op, Pointer};

/// An instruction with its address, on which the text of a relative jump depends.
pub struct Text(pub Op, pub u32);

impl fmt::Display for Text {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let offset = |target: u32| i64::from(target) - i64::from(self.1) - 2;
        match self.0 {
            Op::Movw(d, r) => write!(f, "movw r{d}, r{r}"),
            Op::Two(what, d, r) => write!(f, "{} r{d}, r{r}", mnemonic(what)),
            Op::Cpse(d, r) => write!(f, "cpse r{d}, r{r}"),
            Op::Product(what, d, r) => write!(f, "{} r{d}, r{r}", mnemonic(what)),
            Op::Immediate(what, d, k) => write!(f, "{} r{d}, 0x{k:02X}", mnemonic(what)),
            Op::One(what, d) => write!(f, "{} r{d}", mnemonic(what)),
            Op::Adiw(d, k) => write!(f, "adiw r{d}, 0x{k:02x}"),
            Op::Sbiw(d, k) => write!(f, "sbiw r{d}, 0x{k:02x}"),
            Op::Load(d, pointer, mode @ Mode::Displaced(1..)) => {
                write!(f, "ldd r{d}, {}", At(pointer, mode))
            }
            Op::Load(d, pointer, mode) => write!(f, "ld r{d}, {}", At(pointer, mode)),
            Op::Store(r, pointer, mode @ Mode::Displaced(1..)) => {
                write!(f, "std {}, r{r}", At(pointer, mode))
            }
            Op::Store(r, pointer, mode) => write!(f, "st {}, r{r}", At(pointer, mode)),
            Op::Lds(d, k) => write!(f, "lds r{d}, 0x{k:04X}"),
            Op::Sts(k, r) => write!(f, "sts 0x{k:04X}, r{r}"),
            Op::Lpm(d, increments) => write!(f, "lpm r{d}, Z{}", if increments { "+" } else { "" }),
            Op::Push(r) => write!(f, "push r{r}"),
            Op::Pop(d) => write!(f, "pop r{d}"),
            Op::In(d, io) => write!(f, "in r{d}, 0x{io:02x}"),
            Op::Out(io, r) => write!(f, "out 0x{io:02x}, r{r}"),
            Op::Sbi(io, bit) => write!(f, "sbi 0x{io:02x}, {bit}"),
            Op::Cbi(io, bit) => write!(f, "cbi 0x{io:02x}, {bit}"),
            Op::Sbic(io, bit) => write!(f, "sbic 0x{io:02x}, {bit}"),
            Op::Sbis(io, bit) => write!(f, "sbis 0x{io:02x}, {bit}"),
            Op::Sbrc(r, bit) => write!(f, "sbrc r{r}, {bit}"),
            Op::Sbrs(r, bit) => write!(f, "sbrs r{r}, {bit}"),
            Op::Bld(d, bit) => write!(f, "bld r{d}, {bit}"),
            Op::Bst(d, bit) => write!(f, "bst r{d}, {bit}"),
            Op::Bset(flag) => write!(f, "se{}", FLAGS[usize::from(flag)]),
            Op::Bclr(flag) => write!(f, "cl{}", FLAGS[usize::from(flag)]),
            Op::Brbs(flag, to) => write!(f, "{} .{:+}", IF_SET[usize::from(flag)], offset(to)),
            Op::Brbc(flag, to) => write!(f, "{} .{:+}", IF_CLEAR[usize::from(flag)], offset(to)),
            Op::Rjmp(to) => write!(f, "rjmp .{:+}", offset(to)),
            Op::Rcall(to) => write!(f, "rcall .{:+}", offset(to)),
            Op::Jmp(to) => write!(f, "jmp 0x{to:x}"),
            Op::Call(to) => write!(f, "call 0x{to:x}"),
            Op::LpmR0 => f.write_str("lpm"),
            simple => f.write_str(&mnemonic(simple)),
        }
    }
}

/// The flags of SREG from bit 0.
const FLAGS: [&str; 8] = ["c", "z", "n", "v", "s", "h", "t", "i"];
/// The branches if a flag is 1.
const IF_SET: [&str; 8] = ["brcs", "breq", "brmi", "brvs", "brlt", "brhs", "brts", "brie"];
/// The branches if a flag is 0.
const IF_CLEAR: [&str; 8] = ["brcc", "brne", "brpl", "brvc", "brge", "brhc", "brtc", "brid"];

/// The mnemonic of an operation, which is its name.
fn mnemonic(what: impl fmt::Debug) -> String {
    format!("{what:?}").to_lowercase()
}

/// The operand of a load or store.
struct At(Pointer, Mode);

impl fmt::Display for At {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(pointer, mode) = self;
        match mode {
            Mode::Displaced(0) => write!(f, "{pointer:?}"),
            Mode::Displaced(q) => write!(f, "{pointer:?}+{q}"),
            Mode::PostIncrement => write!(f, "{pointer:?}+"),
            Mode::PreDecrement => write!(f, "-{pointer:?}"),
        }
    }
}
