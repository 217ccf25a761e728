//! What is known of the processor before an instruction: registers, flags, the stack since the
//! entry of the function, and the bits that enable interrupts.

use std::collections::BTreeSet;

use anyhow::{Result, bail};

pub use crate::enables::{ENABLE_REGISTERS, Enables};
use crate::opcode::{FLAG_C, FLAG_H, FLAG_N, FLAG_S, FLAG_V, FLAG_Z};
use crate::value::{ENTRY_PAIRS, ENTRY_SP, Half, SymbolId, Value, named};

/// The I flag.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Interrupts {
    /// Interrupts are disabled.
    Disabled,
    /// Interrupts are enabled.
    Enabled,
    /// Either, depending on the path.
    Either,
}

impl Interrupts {
    /// True if an interrupt can happen.
    pub fn may_happen(self) -> bool {
        self != Self::Disabled
    }

    fn join(self, other: Self) -> Self {
        if self == other { self } else { Self::Either }
    }
}

/// A comparison or a result, whose flags a branch can test.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Test {
    /// Nothing is known.
    None,
    /// The bytes of two numbers, lowest first, which were subtracted without storing the result.
    Compare(Vec<(Value, Value)>),
    /// The bytes of a result, lowest first.
    Result(Vec<Value>),
    /// The bytes of the difference of a number and a constant, the number's bytes before, and the
    /// constant's.
    Difference(Vec<Value>, Vec<Value>, Vec<u8>),
    /// The result of DEC, and the value before. DEC leaves the carry.
    Decrement(Value, Value),
}

impl Test {
    /// What is true of both.
    fn join(&self, other: &Self) -> Self {
        let values = |a: &[Value], b: &[Value]| -> Vec<Value> {
            a.iter().zip(b).map(|(a, b)| a.join(*b)).collect()
        };
        match (self, other) {
            (Self::Compare(a), Self::Compare(b)) if a.len() == b.len() => {
                let join = |((l, r), (left, right)): (&(Value, Value), &(Value, Value))| {
                    (l.join(*left), r.join(*right))
                };
                Self::Compare(a.iter().zip(b).map(join).collect())
            }
            (Self::Result(a), Self::Result(b)) if a.len() == b.len() => Self::Result(values(a, b)),
            (Self::Difference(new, old, k), Self::Difference(other_new, other_old, other_k))
                if k == other_k =>
            {
                Self::Difference(values(new, other_new), values(old, other_old), k.clone())
            }
            (Self::Decrement(new, old), Self::Decrement(other_new, other_old)) => {
                Self::Decrement(new.join(*other_new), old.join(*other_old))
            }
            _ => Self::None,
        }
    }
}

/// The arithmetic flags.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Flags {
    /// The flags that are known: bits as in SREG.
    pub known: u8,
    /// Their values.
    pub bits: u8,
    /// What set them.
    pub test: Test,
    /// The carry is that of the low byte of this symbol plus its offset, to which the constant was
    /// added (or, negative, from which it was subtracted).
    pub chain: Option<(Half, i16)>,
}

impl Flags {
    const UNKNOWN: Self = Self { known: 0, bits: 0, test: Test::None, chain: None };

    /// A flag, if it is known.
    pub fn get(&self, flag: u8) -> Option<bool> {
        (self.known >> flag & 1 != 0).then_some(self.bits >> flag & 1 != 0)
    }

    /// Sets a flag, or forgets it.
    pub fn set(&mut self, flag: u8, value: Option<bool>) {
        let mask = 1 << flag;
        self.known = self.known & !mask | if value.is_some() { mask } else { 0 };
        self.bits = self.bits & !mask | if value == Some(true) { mask } else { 0 };
    }

    /// Forgets the flags of arithmetic; T stays.
    pub fn forget(&mut self) {
        for flag in [FLAG_C, FLAG_Z, FLAG_N, FLAG_V, FLAG_S, FLAG_H] {
            self.set(flag, None);
        }
        self.forget_test();
    }

    /// Forgets what the flags come from.
    pub fn forget_test(&mut self) {
        self.test = Test::None;
        self.chain = None;
    }

    fn join(&mut self, other: &Self) {
        let same = self.known & other.known & !(self.bits ^ other.bits);
        self.known = same;
        self.bits &= same;
        self.test = self.test.join(&other.test);
        if self.chain != other.chain {
            self.chain = None;
        }
    }
}

/// A byte of the stack.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Slot {
    /// Its value.
    pub value: Value,
    /// True if PUSH wrote it, and not a store to a local variable.
    pub is_pushed: bool,
}

impl Slot {
    /// An unknown byte of a local variable.
    pub const LOCAL: Self = Self { value: Value::ANY, is_pushed: false };
}

/// A read-modify-write in progress: the bits of a register that are known of a byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct KnownBits {
    /// Bits that are 0.
    pub zeros: u8,
    /// Bits that are 1.
    pub ones: u8,
    /// Bits that the register `of` had at the entry of the function.
    pub same: u8,
    /// A register in the data space, if `same` is not 0.
    pub of: u16,
}

impl KnownBits {
    /// Nothing is known.
    pub const NONE: Self = Self { zeros: 0, ones: 0, same: 0, of: 0 };

    fn join(&mut self, other: &Self) {
        self.zeros &= other.zeros;
        self.ones &= other.ones;
        self.same &= if self.of == other.of { other.same } else { 0 };
    }
}

/// What is known before an instruction.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct State {
    /// The registers r0 to r31.
    pub registers: [Value; 32],
    /// Single bits of the registers, for read-modify-write of enable bits.
    pub bits: [KnownBits; 32],
    /// The arithmetic flags.
    pub flags: Flags,
    /// The bytes on the stack since the entry, the first pushed first.
    pub stack: Vec<Slot>,
    /// A half of SP that was written, while the other was not yet.
    pub half_sp: Option<(bool, Value)>,
    /// The stack pointer at the entry, if the program has set it.
    pub base: Option<u16>,
    /// The I flag.
    pub interrupts: Interrupts,
    /// Bits that enable interrupts.
    pub enables: Enables,
    /// The bits of [`ENABLE_REGISTERS`] that are as at the entry of the function.
    pub kept: [u8; ENABLE_REGISTERS.len()],
    /// The flags that are as at the entry: bits as in SREG, without I.
    pub kept_flags: u8,
    /// True at the start of the program, which may set SP to a constant.
    pub is_start: bool,
    /// Cycles since the last write of SPDR, at least. The count stops at 31.
    pub since_spdr: u8,
}

/// All flags but I.
pub const ALL_FLAGS: u8 = 0x7F;

impl State {
    /// At the entry of a function. Each pair of registers has its symbol.
    pub fn at_entry(interrupts: Interrupts, enables: Enables) -> Self {
        let registers = std::array::from_fn(|r| Value::symbol(entry_half(r as u8)));
        Self {
            registers,
            bits: [KnownBits::NONE; 32],
            flags: Flags::UNKNOWN,
            stack: Vec::new(),
            half_sp: None,
            base: None,
            interrupts,
            enables,
            kept: [u8::MAX; ENABLE_REGISTERS.len()],
            kept_flags: ALL_FLAGS,
            is_start: false,
            since_spdr: 0,
        }
    }

    /// The value of a register.
    pub fn get(&self, r: u8) -> Value {
        self.registers[usize::from(r)]
    }

    /// Sets a register.
    pub fn set(&mut self, r: u8, value: Value) {
        self.registers[usize::from(r)] = value;
        let (zeros, ones) = match value.known() {
            Some(known) => (!known, known),
            None => (0, 0),
        };
        self.bits[usize::from(r)] = KnownBits { zeros, ones, ..KnownBits::NONE };
    }

    /// Replaces a symbol that is named anew: what has its old value loses it.
    fn forget_symbol(&mut self, id: SymbolId) {
        let drop = |value: &mut Value| {
            if value.half.is_some_and(|half| half.id == id) {
                value.half = None;
            }
        };
        self.registers.iter_mut().for_each(drop);
        self.stack.iter_mut().for_each(|slot| drop(&mut slot.value));
        match &mut self.flags.test {
            Test::None => {}
            Test::Compare(bytes) => bytes.iter_mut().for_each(|(left, right)| {
                drop(left);
                drop(right);
            }),
            Test::Result(bytes) => bytes.iter_mut().for_each(drop),
            Test::Difference(new, old, _) => {
                new.iter_mut().for_each(drop);
                old.iter_mut().for_each(drop);
            }
            Test::Decrement(new, old) => {
                drop(new);
                drop(old);
            }
        }
        if self.flags.chain.is_some_and(|(half, _)| half.id == id) {
            self.flags.chain = None;
        }
    }

    /// Gives a register a symbol of its own, number `n` of the instruction at `at`, if it has none.
    /// A known value gets one, too, so that it is the same symbol in each round of a loop.
    pub fn name(&mut self, r: u8, at: u32, n: u32) {
        if self.get(r).half.is_none() {
            let id = named(at, n);
            self.forget_symbol(id);
            self.registers[usize::from(r)].half = Some(Half::low(id, 0));
        }
    }

    /// Gives a pair of registers a symbol, if its bytes have none.
    pub fn name_pair(&mut self, low: u8, at: u32) {
        let (a, b) = (self.get(low), self.get(low + 1));
        if a.half.is_none() && b.half.is_none() {
            let id = named(at, 0);
            self.forget_symbol(id);
            self.registers[usize::from(low)].half = Some(Half::low(id, 0));
            self.registers[usize::from(low) + 1].half = Some(Half::high(id, 0));
        }
    }

    /// Narrows the range of everything that equals `value`; false if that is impossible.
    pub fn refine(&mut self, value: Value, lo: u8, hi: u8) -> bool {
        if value.meet(lo, hi).is_none() {
            return false;
        }
        let Some(half) = value.half.filter(|half| half.is_number()) else { return true };
        let narrow = |value: &mut Value| {
            if value.half != Some(half) {
                return true;
            }
            match value.meet(lo, hi) {
                Some(narrower) => {
                    *value = narrower;
                    true
                }
                None => false,
            }
        };
        self.registers.iter_mut().all(narrow)
            && self.stack.iter_mut().all(|slot| narrow(&mut slot.value))
    }

    /// Bytes on the stack since the entry.
    pub fn height(&self) -> u32 {
        self.stack.len() as u32
    }

    /// The slot at the entry's SP plus `offset`, which is 0 or negative.
    pub fn slot(&mut self, offset: u16) -> Option<&mut Slot> {
        let index = usize::from(offset.wrapping_neg());
        self.stack.get_mut(index)
    }

    /// Forgets the local variables in memory: something stored to an unknown address.
    pub fn forget_locals(&mut self) {
        for slot in self.stack.iter_mut().filter(|slot| !slot.is_pushed) {
            slot.value = Value::ANY;
        }
    }

    /// Forgets the bytes that a function has stored above its own part of the stack, at offsets
    /// from its SP at the entry, which is `height` below that of this function. Returns the offsets
    /// from the latter that are not in the part of this function.
    pub fn forget_above(&mut self, above: &BTreeSet<u16>, height: u32) -> Vec<u16> {
        let mut beyond = Vec::new();
        for offset in above {
            match u32::from(*offset).checked_sub(height) {
                Some(offset) if offset > 0 => beyond.push(offset as u16),
                _ => {
                    if let Some(slot) = self.stack.get_mut((height - u32::from(*offset)) as usize) {
                        *slot = Slot::LOCAL;
                    }
                }
            }
        }
        beyond
    }

    /// Writes a half of SP. The other half must follow before the stack is used.
    pub fn write_sp(&mut self, is_high: bool, value: Value, may_be_absolute: bool) -> Result<()> {
        let Some((was_high, other)) = self.half_sp.take() else {
            self.half_sp = Some((is_high, value));
            return Ok(());
        };
        if was_high == is_high {
            bail!("one half of SP is written twice");
        }
        let (low, high) = if is_high { (other, value) } else { (value, other) };
        if let Some((ENTRY_SP, offset)) = crate::value::pair(low, high) {
            let height = usize::from(offset.wrapping_neg());
            if height > 0x800 {
                bail!("SP is set to above its value at the entry of the function");
            }
            self.stack.resize(height, Slot::LOCAL);
            return Ok(());
        }
        match (low.known(), high.known()) {
            (Some(low), Some(high)) if may_be_absolute => {
                self.base = Some(u16::from_le_bytes([low, high]));
                self.stack.clear();
                self.forget_symbol(ENTRY_SP);
                Ok(())
            }
            (Some(_), Some(_)) => bail!("SP is set to a constant outside the start of the program"),
            _ => bail!("SP is set to a computed value: give alloca and arrays a constant length"),
        }
    }

    /// What is known of both states, which meet at an instruction.
    ///
    /// # Errors
    /// If the stack has another height, or only one path has set SP.
    pub fn join(&mut self, other: &Self) -> Result<()> {
        if self.stack.len() != other.stack.len() {
            bail!(
                "the stack has {} bytes on one path and {} on another: a push without a pop",
                self.stack.len().min(other.stack.len()),
                self.stack.len().max(other.stack.len())
            );
        }
        if self.base != other.base
            || self.half_sp.map(|(high, _)| high) != other.half_sp.map(|(high, _)| high)
        {
            bail!("one path sets SP and another does not");
        }
        if let (Some((_, value)), Some((_, theirs))) = (&mut self.half_sp, other.half_sp) {
            *value = value.join(theirs);
        }
        for (value, theirs) in self.registers.iter_mut().zip(&other.registers) {
            *value = value.join(*theirs);
        }
        for (bits, theirs) in self.bits.iter_mut().zip(&other.bits) {
            bits.join(theirs);
        }
        for (kept, theirs) in self.kept.iter_mut().zip(&other.kept) {
            *kept &= theirs;
        }
        self.kept_flags &= other.kept_flags;
        for (slot, theirs) in self.stack.iter_mut().zip(&other.stack) {
            slot.value = slot.value.join(theirs.value);
            slot.is_pushed &= theirs.is_pushed;
        }
        self.flags.join(&other.flags);
        self.interrupts = self.interrupts.join(other.interrupts);
        self.enables.join(&other.enables);
        self.since_spdr = self.since_spdr.min(other.since_spdr);
        Ok(())
    }

    /// Forgets the bounds that have moved since `before`, so that repeated joins end.
    pub fn widen(&mut self, before: &Self) {
        for (value, old) in self.registers.iter_mut().zip(&before.registers) {
            *value = value.widened(*old);
        }
        for (slot, old) in self.stack.iter_mut().zip(&before.stack) {
            slot.value = slot.value.widened(old.value);
        }
        if self.since_spdr < before.since_spdr {
            self.since_spdr = 0;
        }
    }
}

/// The symbol of a register at the entry of a function.
pub fn entry_half(r: u8) -> Half {
    let id = ENTRY_PAIRS + u32::from(r / 2);
    if r.is_multiple_of(2) { Half::low(id, 0) } else { Half::high(id, 0) }
}

impl State {
    /// Gives the pair of a low byte a symbol before a constant is added to it, unless the pair is
    /// known, so that the carry to the high byte is followed.
    pub fn name_pair_for_chain(&mut self, low: u8, constant: u8, at: u32) {
        if constant != 0 || self.get(low).known().is_none() {
            self.name_pair(low, at);
        }
    }
}
