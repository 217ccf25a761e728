//! What the analysis finds of a function: its stack, its jumps, and its effect on registers.

use std::collections::{BTreeMap, BTreeSet};

use crate::chip::INTERRUPTS;
use crate::memory::Written;
use crate::program::Program;
use crate::state::{ENABLE_REGISTERS, Enables, Interrupts, State, entry_half};
use crate::value::Value;

/// A function, and how it is entered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Entry {
    /// Its address.
    pub address: u32,
    /// Whether it is called, or begins with a reset or an interrupt.
    pub kind: Kind,
    /// The I flag.
    pub interrupts: Interrupts,
    /// Bits that enable interrupts.
    pub enables: Enables,
}

/// What a function is entered by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// A call, with r1 known to be 0, as the compilers have it, or not.
    Called {
        /// True if it is known.
        with_zero: bool,
    },
    /// A reset.
    Reset,
    /// An interrupt.
    Handler,
}

impl Kind {
    /// True for a call.
    pub fn is_called(self) -> bool {
        matches!(self, Self::Called { .. })
    }
}

impl Entry {
    /// How a function is entered by a call.
    pub fn called(address: u32, caller: &State) -> Self {
        let with_zero = caller.get(1).known() == Some(0);
        let State { interrupts, enables, .. } = *caller;
        Self { address, kind: Kind::Called { with_zero }, interrupts, enables }
    }
}

/// A depth of the stack in bytes, and the call that leads to it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Depth {
    /// Bytes since the entry of the function, with all that it calls.
    pub bytes: u32,
    /// Bytes of the function itself.
    pub own: u32,
    /// The function that is called there.
    pub callee: Option<Entry>,
}

/// What is known of a function.
#[derive(Debug, Clone, Default)]
pub struct Summary {
    /// The deepest stack.
    pub depth: Depth,
    /// The deepest stack while interrupts may be enabled, and what is known of the enable bits
    /// whenever they are.
    pub enabled: Option<(Depth, Enables)>,
    /// The state at the end; `None` if the function does not return.
    pub exit: Option<Exit>,
    /// Bits of [`ENABLE_REGISTERS`] that the function or those that it calls may set.
    pub sets: [u8; ENABLE_REGISTERS.len()],
    /// The stack pointer at the start, if the program sets it.
    pub base: Option<u16>,
    /// True if a path leads to the start of the program.
    pub restarts: bool,
    /// True if interrupts may be enabled then.
    pub restarts_enabled: bool,
    /// The deepest stack before the start of the program sets SP.
    pub before_base: u32,
    /// The first instruction at which interrupts may be enabled.
    pub enabled_at: Option<u32>,
    /// True if it writes SPDR.
    pub writes_spdr: bool,
    /// True if it stores through a pointer whose address is not known.
    pub stores: bool,
    /// Bytes above its own stack that it stores: offsets from SP at the entry.
    pub above: BTreeSet<u16>,
    /// The jumps of the function: from an instruction to the next ones. A call leads to the
    /// instruction behind it.
    pub edges: BTreeSet<(u32, u32)>,
    /// The states at the heads of loops and other places where paths meet.
    pub states: BTreeMap<u32, State>,
    /// The registers that the functions called at an address read.
    pub calls: BTreeMap<u32, u32>,
    /// The registers that the function reads before it writes them.
    pub reads: u32,
}

/// The state at the end of a function.
#[derive(Debug, Clone)]
pub struct Exit {
    /// Registers that have the value that they had at the entry.
    pub preserved: [bool; 32],
    /// The other registers.
    pub registers: [Value; 32],
    /// The I flag.
    pub interrupts: Interrupts,
    /// Bits that enable interrupts.
    pub enables: Enables,
    /// The bits of [`ENABLE_REGISTERS`] that are as at the entry.
    pub kept: [u8; ENABLE_REGISTERS.len()],
    /// The flags that are as at the entry.
    pub kept_flags: u8,
}

impl Summary {
    /// Counts the stack before an instruction.
    pub(crate) fn visit(&mut self, state: &State, at: u32) {
        if state.base.is_none() {
            self.before_base = self.before_base.max(state.height());
        }
        if state.interrupts.may_happen() {
            self.enabled_at.get_or_insert(at);
        }
        let own = Depth { bytes: state.height(), own: state.height(), callee: None };
        self.depth = self.depth.max(own);
        if state.interrupts.may_happen() {
            self.count_enabled(own, &state.enables);
        }
    }

    /// Counts the stack of a function that is called at a height.
    pub(crate) fn count(&mut self, height: u32, entry: Entry, callee: &Summary) {
        let at =
            |depth: Depth| Depth { bytes: height + depth.bytes, own: height, callee: Some(entry) };
        self.depth = self.depth.max(at(callee.depth));
        if let Some((depth, enables)) = &callee.enabled {
            self.count_enabled(at(*depth), enables);
        }
        for (mine, theirs) in self.sets.iter_mut().zip(callee.sets) {
            *mine |= theirs;
        }
        self.restarts |= callee.restarts;
        self.restarts_enabled |= callee.restarts_enabled;
        self.writes_spdr |= callee.writes_spdr;
        self.stores |= callee.stores;
        self.enabled_at = self.enabled_at.or(callee.enabled_at);
    }

    fn count_enabled(&mut self, depth: Depth, enables: &Enables) {
        match &mut self.enabled {
            Some((deepest, known)) => {
                *deepest = deepest.max(depth);
                known.join(enables);
            }
            none => *none = Some((depth, *enables)),
        }
    }

    /// Notes what an instruction writes.
    pub(crate) fn note(&mut self, written: &Written) {
        if let Some((index, bits)) = written.sets {
            self.sets[index] |= bits;
        }
        self.writes_spdr |= written.is_spdr;
        self.stores |= written.is_anywhere;
        self.above.extend(written.above);
    }
}

impl Depth {
    fn max(self, other: Self) -> Self {
        if other.bytes > self.bytes { other } else { self }
    }
}

impl Exit {
    pub(crate) fn of(entry: Entry, state: &State) -> Self {
        let preserved = std::array::from_fn(|r| {
            let value = state.registers[r];
            let is_zero = r == 1 && entry.kind == (Kind::Called { with_zero: true });
            value.half == Some(entry_half(r as u8)) || is_zero && value.known() == Some(0)
        });
        Self {
            preserved,
            registers: state.registers.map(Value::plain),
            interrupts: state.interrupts,
            enables: state.enables,
            kept: state.kept,
            kept_flags: state.kept_flags,
        }
    }

    pub(crate) fn join(&mut self, other: &Self) {
        for r in 0..32 {
            self.preserved[r] &= other.preserved[r];
            self.registers[r] = self.registers[r].join(other.registers[r]);
        }
        if self.interrupts != other.interrupts {
            self.interrupts = Interrupts::Either;
        }
        self.enables.join(&other.enables);
        for (kept, theirs) in self.kept.iter_mut().zip(&other.kept) {
            *kept &= theirs;
        }
        self.kept_flags &= other.kept_flags;
    }

    /// The state of the caller after the call.
    pub(crate) fn apply(&self, state: &mut State) {
        for r in (0..32u8).filter(|r| !self.preserved[usize::from(*r)]) {
            state.set(r, self.registers[usize::from(r)]);
        }
        state.flags.forget();
        state.flags.set(crate::opcode::FLAG_T, None);
        state.interrupts = self.interrupts;
        state.enables = self.enables;
        for (kept, theirs) in state.kept.iter_mut().zip(&self.kept) {
            *kept &= theirs;
        }
        state.kept_flags &= self.kept_flags;
        state.since_spdr = 0;
        state.forget_locals();
    }
}

/// A vector of an interrupt that can happen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Vector {
    /// The interrupt, an index of [`INTERRUPTS`].
    pub interrupt: usize,
    /// Where the vector jumps to, or the vector itself if it contains other code than a jump.
    pub address: u32,
    /// Cycles from the beginning of the response to the first instruction there: four that push the
    /// program counter, and the jump.
    pub cycles: u32,
    /// True if the vector leads to the start of the program.
    pub restarts: bool,
}

impl Vector {
    /// How its handler begins.
    pub fn entry(&self) -> Entry {
        handler(self.address, self.interrupt)
    }

    /// The interrupt's name in the datasheet.
    pub fn name(&self) -> &'static str {
        INTERRUPTS[self.interrupt].name
    }
}

/// How the program begins after a reset: interrupts and all their enable bits are 0.
pub fn reset(program: &Program) -> Entry {
    Entry {
        address: program.entry,
        kind: Kind::Reset,
        interrupts: Interrupts::Disabled,
        enables: Enables::default(),
    }
}

/// How a handler begins: its own interrupt is enabled, and interrupts are disabled.
pub fn handler(address: u32, interrupt: usize) -> Entry {
    let mut enables = Enables::default();
    let (register, bit) = INTERRUPTS[interrupt].enable;
    enables.set(register, bit, true);
    Entry { address, kind: Kind::Handler, interrupts: Interrupts::Disabled, enables }
}
