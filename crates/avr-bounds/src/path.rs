//! The paths of a function that is followed: the states and times at the instructions that come
//! next, and those at its end.

use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use anyhow::Result;

use crate::clock::{Clocks, Kinds};
use crate::enables::Enables;
use crate::order::{Loop, Part};
use crate::state::{State, entry_half};
use crate::summary::{Kind, Summary};
use crate::value::{ENTRY_PAIRS, Half, Value, pair};

/// The times of a function.
#[derive(Debug, Clone, Default)]
pub struct Time {
    /// At the end: the state and the clocks. `None` if the function does not return.
    pub exit: Option<(State, Clocks)>,
    /// Stretches that began before the entry and end in the function: cycles from the entry, and
    /// the address of the end, for each watch.
    pub ended: Vec<Option<(u32, u32)>>,
    /// The longest time from the entry to a jump to address 0.
    pub restart: Option<u32>,
    /// The longest time from the entry to the end of each SBI and CBI, by its address.
    pub bits: BTreeMap<u32, u32>,
    /// The functions that it may call, and those that they may call, by their addresses.
    pub calls: BTreeSet<u32>,
}

/// The parts of a function.
#[derive(Debug)]
pub struct Order {
    /// The parts, in order.
    pub parts: Vec<Part>,
    /// Heads of all loops, by address.
    pub heads: Vec<u32>,
}

/// The bound of a loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bound {
    /// Number of the loop in its function, counted from 1.
    pub number: usize,
    /// How often it goes back to its head, each time it is reached.
    pub rounds: u32,
    /// Cycles of all these rounds.
    pub cycles: u32,
}

/// A loop of which an annotation tells how often it goes back to its head.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Told {
    /// Number of the loop in its function, counted from 1.
    pub number: usize,
    /// The addresses of the instructions that go back.
    pub backs: BTreeSet<u32>,
    /// How often at most, each time it is reached.
    pub at_most: u32,
}

/// A loop whose rounds are not counted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Open {
    /// Number of the loop in its function, counted from 1.
    pub number: usize,
    /// Cycles of its longest round; `u32::MAX` if it has no bound.
    pub cycles: u32,
    /// What ends it, from the annotation.
    pub until: String,
    /// Why its time has a bound, or need not have one.
    pub reason: String,
}

/// The longest round of a loop that never ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Turn {
    /// Instructions of the loop, a call as many.
    pub size: usize,
    /// Its first instruction.
    pub head: u32,
    /// Cycles of a round; `u32::MAX` if it has no bound.
    pub cycles: u32,
    /// True if an annotation says that it is the main loop.
    pub is_named: bool,
    /// True if it contains a loop whose rounds are not counted.
    pub is_open: bool,
    /// What is known of the bits that enable interrupts, whenever a round begins.
    pub enables: Enables,
}

impl Turn {
    /// Keeps the longest round of the largest loop, or of the one that an annotation names.
    pub fn keep_larger(known: &mut Option<Self>, turn: Self) {
        let is_larger = |known: &Self| match turn.head == known.head {
            true => turn.cycles > known.cycles,
            false => (turn.is_named, turn.size) > (known.is_named, known.size),
        };
        if known.as_ref().is_none_or(is_larger) {
            *known = Some(turn);
        }
    }
}

/// A function that is followed.
pub struct Run {
    /// How it was entered.
    pub kind: Kind,
    /// What is known of the function.
    pub summary: Rc<Summary>,
    /// Its parts.
    pub order: Rc<Order>,
    /// The instructions that come next. Boxed: a state has a kilobyte, which the map would move.
    pub pending: BTreeMap<u32, Box<(State, Clocks)>>,
    /// Its times.
    pub time: Time,
    /// Loops without a bound are noted, and not errors.
    pub is_lenient: bool,
    /// A loop was found that has no bound. The function must be followed once more.
    pub is_incomplete: bool,
    /// The bounds of its loops.
    pub bounds: Vec<(u32, Bound)>,
    /// Its loops whose rounds are not counted, by the address of the head.
    pub opens: Vec<(u32, Open)>,
    /// The longest round of its largest endless loop.
    pub turn: Option<Turn>,
    /// For each endless loop, by the address of the head, and each function that it calls:
    /// cycles of its longest round with the call.
    pub through: BTreeMap<u32, BTreeMap<u32, u32>>,
    /// For each endless loop, by the address of the head, and each set of kinds: cycles of its
    /// longest round of just these kinds.
    pub of_kinds: BTreeMap<u32, BTreeMap<Kinds, u32>>,
}

impl Run {
    /// True if a jump leaves a loop.
    pub fn has_exit(&self, inner: &Loop) -> bool {
        let is_outside = |to: &u32| !inner.nodes.contains(to);
        let edges = &self.summary.edges;
        edges.iter().any(|(from, to)| inner.nodes.contains(from) && is_outside(to))
    }

    /// The addresses of the instructions that go back to the head of a loop.
    pub fn backs(&self, inner: &Loop) -> BTreeSet<u32> {
        let edges = self.summary.edges.iter();
        let back = edges.filter(|(from, to)| *to == inner.head && inner.nodes.contains(from));
        back.map(|(from, _)| *from).collect()
    }

    /// True if a loop has no exit, or is the largest of a function that does not return: then its
    /// exits lead to a restart.
    pub fn is_endless(&self, inner: &Loop) -> bool {
        let loops = self.order.parts.iter().filter_map(|part| match part {
            Part::Loop(inner) => Some(inner),
            Part::Instruction(_) => None,
        });
        let largest = loops.max_by_key(|other| other.nodes.len());
        let never_returns = self.summary.exit.is_none();
        !self.has_exit(inner)
            || never_returns && largest.is_some_and(|largest| largest.head == inner.head)
    }

    /// Adds a path to an instruction.
    pub fn reach(&mut self, to: u32, state: State, clocks: Clocks) -> Result<()> {
        match self.pending.get_mut(&to).map(Box::as_mut) {
            Some((known, longest)) => {
                known.join(&state)?;
                longest.join(&clocks);
            }
            None => {
                self.pending.insert(to, Box::new((state, clocks)));
            }
        }
        Ok(())
    }

    /// Notes a round of an endless loop.
    pub fn note_turn(&mut self, turn: Turn) {
        Turn::keep_larger(&mut self.turn, turn);
    }

    /// Adds a path to the end.
    pub fn leave(&mut self, state: State, clocks: &Clocks) -> Result<()> {
        join_exit(&mut self.time.exit, state, clocks)
    }
}

fn join_exit(exit: &mut Option<(State, Clocks)>, state: State, clocks: &Clocks) -> Result<()> {
    match exit {
        Some((known, longest)) => {
            known.join(&state)?;
            longest.join(clocks);
        }
        none => *none = Some((state, clocks.clone())),
    }
    Ok(())
}

impl Time {
    /// The longer of two.
    ///
    /// # Errors
    /// If the functions leave different stacks.
    pub fn join(&mut self, other: &Self) -> Result<()> {
        if let Some((state, clocks)) = &other.exit {
            join_exit(&mut self.exit, state.clone(), clocks)?;
        }
        self.restart = self.restart.max(other.restart);
        for (mine, theirs) in self.ended.iter_mut().zip(&other.ended) {
            *mine = (*mine).max(*theirs);
        }
        for (at, cycles) in &other.bits {
            self.note_bit(*at, *cycles);
        }
        Ok(())
    }

    /// Notes the time of an SBI or CBI.
    pub fn note_bit(&mut self, at: u32, cycles: u32) {
        let known = self.bits.entry(at).or_default();
        *known = cycles.max(*known);
    }
}

/// The state of the caller after a call.
pub fn after_call(mut caller: State, exit: &State) -> State {
    let before = caller.registers;
    for r in 0..32u8 {
        let value = exit.get(r);
        if value.half == Some(entry_half(r)) {
            continue;
        }
        caller.set(r, value.with(value.half.and_then(|half| of_caller(&before, half))));
    }
    caller.flags.forget();
    caller.flags.set(crate::opcode::FLAG_T, None);
    caller.interrupts = exit.interrupts;
    caller.enables = exit.enables;
    for (kept, theirs) in caller.kept.iter_mut().zip(&exit.kept) {
        *kept &= theirs;
    }
    caller.kept_flags &= exit.kept_flags;
    caller.since_spdr = exit.since_spdr;
    caller.forget_locals();
    caller
}

/// The symbol of a caller's pair of registers plus an offset.
fn of_caller(registers: &[Value; 32], half: Half) -> Option<Half> {
    let index = half.id.checked_sub(ENTRY_PAIRS).filter(|index| *index < 16)? as usize;
    let (low, high) = (registers[2 * index], registers[2 * index + 1]);
    if let Some((id, offset)) = pair(low, high) {
        let offset = offset.wrapping_add(half.offset);
        return Some(if half.is_high { Half::high(id, offset) } else { Half::low(id, offset) });
    }
    match (half.is_high, low.half) {
        (false, Some(low)) if !low.is_high => {
            Some(Half::low(low.id, low.offset.wrapping_add(half.offset)))
        }
        (true, _) if half.offset == 0 => high.half,
        _ => None,
    }
}
