//! What interrupt handlers change for the program that they interrupt.
//!
//! Wherever an interrupt can come, what is known must hold with these changes, so they are applied
//! behind each instruction. A handler whose interrupt is masked there does not come.

use crate::chip::INTERRUPTS;
use crate::enables::{ENABLE_REGISTERS, Enables};
use crate::opcode::{FLAG_C, FLAG_H, FLAG_N, FLAG_S, FLAG_T, FLAG_V, FLAG_Z};
use crate::state::State;
use crate::summary::Summary;
use crate::value::Value;

/// What a handler changes, from its response to the end of RETI.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Effect {
    /// Registers of the core, a bit for each.
    pub registers: u32,
    /// Flags of SREG.
    pub flags: u8,
    /// Bits of [`ENABLE_REGISTERS`] that can become 1.
    pub sets: [u8; ENABLE_REGISTERS.len()],
    /// Bits that can be 1 at some time while it runs: the handlers of these can come then.
    pub unmasks: [u8; ENABLE_REGISTERS.len()],
    /// Bits that can become 0.
    pub clears: [u8; ENABLE_REGISTERS.len()],
    /// True if it writes SPDR.
    pub writes_spdr: bool,
    /// True if it stores through a pointer: local variables can change.
    pub stores: bool,
}

impl Effect {
    /// Of the handler of an interrupt, an index of [`INTERRUPTS`].
    pub fn of(handler: &Summary, interrupt: usize) -> Self {
        // A handler that does not return does not change what does not go on.
        let Some(exit) = &handler.exit else { return Self::default() };
        let kept = (0..32).filter(|r| exit.preserved[*r]).fold(0u32, |kept, r| kept | 1 << r);
        let bits = |known: &[u8; ENABLE_REGISTERS.len()]| {
            std::array::from_fn(|at| !exit.kept[at] & !known[at])
        };
        let mut sets = bits(&exit.enables.zeros);
        // It has come, so its own enable bit was 1 before.
        let (register, bit) = INTERRUPTS[interrupt].enable;
        if let Some(own) = Enables::index(register) {
            sets[own] &= !(1 << bit);
        }
        Self {
            registers: !kept,
            flags: !exit.kept_flags & crate::state::ALL_FLAGS,
            sets,
            unmasks: handler.sets,
            clears: bits(&exit.enables.ones),
            writes_spdr: handler.writes_spdr,
            stores: handler.stores,
        }
    }

    /// Adds the changes of another handler. True if there is a new one.
    pub fn join(&mut self, other: &Self) -> bool {
        let before = *self;
        self.registers |= other.registers;
        self.flags |= other.flags;
        for at in 0..ENABLE_REGISTERS.len() {
            self.sets[at] |= other.sets[at];
            self.unmasks[at] |= other.unmasks[at];
            self.clears[at] |= other.clears[at];
        }
        self.writes_spdr |= other.writes_spdr;
        self.stores |= other.stores;
        *self != before
    }

    fn apply(&self, state: &mut State) {
        for r in (0..32u8).filter(|r| self.registers >> r & 1 != 0) {
            state.set(r, Value::ANY);
        }
        if self.flags != 0 {
            for flag in [FLAG_C, FLAG_Z, FLAG_N, FLAG_V, FLAG_S, FLAG_H, FLAG_T] {
                if self.flags >> flag & 1 != 0 {
                    state.flags.set(flag, None);
                }
            }
            state.flags.forget_test();
            state.kept_flags &= !self.flags;
        }
        for at in 0..ENABLE_REGISTERS.len() {
            state.enables.zeros[at] &= !self.sets[at];
            state.enables.ones[at] &= !self.clears[at];
            state.kept[at] &= !(self.sets[at] | self.clears[at]);
        }
        if self.writes_spdr {
            state.since_spdr = 0;
        }
        if self.stores {
            state.forget_locals();
        }
    }
}

/// The handlers of a program: their interrupts, indices of [`INTERRUPTS`], with what they
/// change.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Interference {
    handlers: Vec<(usize, Effect)>,
}

impl Interference {
    /// Adds what a handler changes. True if it was not known.
    pub fn add(&mut self, interrupt: usize, effect: &Effect) -> bool {
        match self.handlers.iter_mut().find(|(known, _)| *known == interrupt) {
            Some((_, known)) => known.join(effect),
            None => {
                self.handlers.push((interrupt, *effect));
                *effect != Effect::default()
            }
        }
    }

    /// What all handlers change that can come in a state, and that those can come that they
    /// unmask.
    pub fn effect(&self, state: &State) -> Effect {
        let (mut all, mut enables) = (Effect::default(), state.enables);
        if !state.interrupts.may_happen() {
            return all;
        }
        // Bits of the handlers that come.
        let (mut come, mut before) = (0u32, u32::MAX);
        while come != before {
            before = come;
            for (n, (interrupt, effect)) in self.handlers.iter().enumerate() {
                if come >> n & 1 == 0 && !enables.is_masked(*interrupt) {
                    come |= 1 << n;
                    all.join(effect);
                    for at in 0..ENABLE_REGISTERS.len() {
                        enables.zeros[at] &= !(effect.sets[at] | effect.unmasks[at]);
                    }
                }
            }
        }
        all
    }

    /// Lets the handlers come, if they can.
    pub fn apply(&self, state: &mut State) {
        if !self.handlers.is_empty() {
            self.effect(state).apply(state);
        }
    }
}
