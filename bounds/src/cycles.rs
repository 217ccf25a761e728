//! The longest path of a function in cycles: follows its paths in order, and each loop round by
//! round, with what is known of the registers, until no path goes back to its head.
//!
//! A function is followed once for each set of ranges of the registers that it reads. If a loop
//! has no bound then, and one of these ranges is small, each of its values is followed by itself.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt;
use std::rc::Rc;

use anyhow::{Result, anyhow};

use crate::clock::{Blocked, Clocks, Ended, Watch};
use crate::opcode::Op;
use crate::order::{Loop, Part, heads, parts};
use crate::program::Program;
use crate::stack::Analysis;
use crate::state::{State, entry_half};
use crate::step::{Flow, Step, step};
use crate::summary::{Entry, Kind, Summary};
use crate::value::{ENTRY_PAIRS, Half, Value, pair};
use crate::wait;

/// Rounds of a loop that are followed, before the analysis gives up.
const MOST_ROUNDS: u32 = 600;

/// A register whose range has at most this width is followed value by value if that is of use.
const MOST_VALUES: u8 = 16;

/// The times of a function.
#[derive(Debug, Clone)]
pub struct Time {
    /// At the end: the state and the clocks. `None` if the function does not return.
    pub exit: Option<(State, Clocks)>,
    /// Stretches that began before the entry and end in the function: cycles from the entry, and
    /// the address of the end, for each watch.
    pub ended: Vec<Option<(u32, u32)>>,
}

/// The analysis of times.
pub struct Timing<'a, 'b> {
    /// What has been found of each function.
    pub analysis: &'b mut Analysis<'a>,
    watches: Vec<Watch>,
    results: HashMap<Key, Rc<Time>>,
    orders: HashMap<Entry, Rc<Order>>,
    /// The stretches that have ended.
    pub ended: Ended,
    /// Loops without a bound.
    pub missing: BTreeSet<String>,
    /// Heads of loops for which the analysis finds no bound.
    unbounded: BTreeSet<u32>,
    /// The loops with a bound, by the address of the head: how often they go back to it at most.
    pub bounds: BTreeMap<u32, Bound>,
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

/// The parts of a function.
#[derive(Debug)]
pub struct Order {
    /// The parts, in order.
    pub parts: Vec<Part>,
    /// Heads of all loops, by address.
    pub heads: Vec<u32>,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Key {
    entry: Entry,
    /// Ranges of the registers that the function reads.
    ranges: Vec<(u8, u8)>,
    since_spdr: u8,
}

/// A function that is followed.
struct Run {
    summary: Rc<Summary>,
    order: Rc<Order>,
    pending: BTreeMap<u32, (State, Clocks)>,
    time: Time,
    /// Loops without a bound are noted, and not errors.
    is_lenient: bool,
    /// A loop was found that has no bound. The function must be followed once more.
    is_incomplete: bool,
    bounds: Vec<(u32, Bound)>,
}

/// A loop has no bound.
#[derive(Debug)]
struct NoBound(String);

impl fmt::Display for NoBound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for NoBound {}

impl<'a, 'b> Timing<'a, 'b> {
    /// An analysis of the paths that `analysis` has found.
    pub fn new(analysis: &'b mut Analysis<'a>, watches: Vec<Watch>) -> Self {
        Self {
            analysis,
            watches,
            results: HashMap::new(),
            orders: HashMap::new(),
            ended: Ended::default(),
            missing: BTreeSet::new(),
            unbounded: BTreeSet::new(),
            bounds: BTreeMap::new(),
        }
    }

    fn program(&self) -> &'a Program {
        self.analysis.program
    }

    /// Follows a function from its entry.
    ///
    /// # Errors
    /// If a path cannot be followed. Loops without a bound are in [`Self::missing`].
    pub fn function(&mut self, entry: Entry) -> Result<Rc<Time>> {
        self.enter(entry, &State::at_entry(entry.interrupts, entry.enables))
    }

    /// Follows a function with the registers of its caller.
    fn enter(&mut self, entry: Entry, caller: &State) -> Result<Rc<Time>> {
        let summary = self.analysis.function(entry)?;
        let mut state = State::at_entry(entry.interrupts, entry.enables);
        if entry.kind == (Kind::Called { with_zero: true }) {
            state.set(1, Value { half: Some(entry_half(1)), ..Value::ZERO });
        }
        let mut ranges = Vec::new();
        for r in (0..32u8).filter(|r| summary.reads >> r & 1 != 0) {
            let Value { lo, hi, .. } = caller.get(r);
            state.set(r, Value { lo, hi, half: Some(entry_half(r)) });
            ranges.push((lo, hi));
        }
        state.since_spdr = caller.since_spdr;
        let key = Key { entry, ranges, since_spdr: state.since_spdr };
        if let Some(known) = self.results.get(&key) {
            return Ok(known.clone());
        }
        let time = match self.run(entry, &summary, state.clone(), false) {
            Err(error) if error.is::<NoBound>() => match narrow_register(&summary, &state) {
                Some(r) => self.each_value(entry, &state, r)?,
                None => self.run(entry, &summary, state, true)?,
            },
            other => other?,
        };
        let time = Rc::new(time);
        self.results.insert(key, time.clone());
        Ok(time)
    }

    /// Follows a function for each value of a register.
    fn each_value(&mut self, entry: Entry, state: &State, r: u8) -> Result<Time> {
        let Value { lo, hi, half } = state.get(r);
        let mut joined: Option<Time> = None;
        for value in lo..=hi {
            let mut state = state.clone();
            state.set(r, Value { half, ..Value::of(value) });
            let time = self.enter(entry, &state)?;
            match &mut joined {
                Some(joined) => joined.join(&time)?,
                none => *none = Some((*time).clone()),
            }
        }
        joined.ok_or_else(|| anyhow!("an empty range"))
    }

    fn run(
        &mut self,
        entry: Entry,
        summary: &Rc<Summary>,
        state: State,
        is_lenient: bool,
    ) -> Result<Time> {
        loop {
            let mut run = self.start(entry, summary, entry.address, state.clone());
            run.is_lenient = is_lenient;
            let order = run.order.clone();
            self.parts(&mut run, &order.parts)?;
            if !run.is_incomplete {
                self.note_bounds(&run);
                return Ok(run.time);
            }
        }
    }

    /// The longest round of an endless loop of a function, in cycles, from the state in which it
    /// begins each time.
    ///
    /// # Errors
    /// If a path cannot be followed.
    pub fn turn(&mut self, entry: Entry, endless: &Loop, state: State) -> Result<u32> {
        let summary = self.analysis.function(entry)?;
        loop {
            let mut run = self.start(entry, &summary, endless.head, state.clone());
            run.is_lenient = true;
            self.instruction(&mut run, endless.head)?;
            self.parts(&mut run, &endless.body)?;
            if !run.is_incomplete {
                self.note_bounds(&run);
                return Ok(run.pending.get(&endless.head).map_or(0, |(_, clocks)| clocks.total));
            }
        }
    }

    /// The parts of a function, in order.
    pub fn order(&mut self, entry: Entry, summary: &Summary) -> Rc<Order> {
        let order = self.orders.entry(entry).or_insert_with(|| {
            let parts = parts(&summary.edges, entry.address);
            Rc::new(Order { heads: heads(&parts), parts })
        });
        order.clone()
    }

    fn start(&mut self, entry: Entry, summary: &Rc<Summary>, at: u32, state: State) -> Run {
        let clocks = Clocks::at_entry(&self.watches, &state);
        Run {
            summary: summary.clone(),
            order: self.order(entry, summary),
            pending: BTreeMap::from([(at, (state, clocks))]),
            time: Time { exit: None, ended: vec![None; self.watches.len()] },
            is_lenient: false,
            is_incomplete: false,
            bounds: Vec::new(),
        }
    }

    fn parts(&mut self, run: &mut Run, parts: &[Part]) -> Result<()> {
        for part in parts {
            match part {
                Part::Instruction(at) => self.instruction(run, *at)?,
                Part::Loop(inner) => self.rounds(run, inner)?,
            }
        }
        Ok(())
    }

    /// Follows a loop until nothing goes back to its head.
    fn rounds(&mut self, run: &mut Run, inner: &Loop) -> Result<()> {
        let head = inner.head;
        let number = 1 + run.order.heads.iter().position(|at| *at == head).unwrap_or(0);
        let function = self.program().function_name(head);
        let annotations = self.analysis.annotations;
        let mut most = annotations.bound(&function, Some(number)).map(|found| found.at_most);
        if most.is_none() && self.unbounded.contains(&head) {
            most = annotations.bound(&function, None).map(|found| found.at_most);
        }
        let since_spdr = run.pending.get(&head).map_or(0, |(state, _)| state.since_spdr);
        let begin = run.pending.get(&head).map_or(0, |(_, clocks)| clocks.total);
        let mut previous: Option<(State, u32)> = None;
        let is_annotated = most.is_some();
        for round in 0.. {
            if let Some((state, clocks)) = run.pending.get(&head)
                && round > 0
            {
                let (before, total) = previous.take().unwrap_or((state.clone(), clocks.total));
                let cycles = clocks.total - total;
                if round == 1 && !is_annotated {
                    most = wait::rounds(self.analysis, inner, &run.summary, since_spdr, cycles);
                }
                let is_stable = *state == before;
                // The program stops in a loop without an exit.
                if most.is_none() && is_stable && inner.has_exit(&run.summary.edges) {
                    most = Some(self.no_bound(run, &function, number, head)?);
                }
                let is_last = most.map_or(is_stable, |most| round > most);
                if is_last || round > MOST_ROUNDS {
                    if round > MOST_ROUNDS {
                        self.no_bound(run, &function, number, head)?;
                    }
                    run.pending.remove(&head);
                    return Ok(());
                }
            } else if round > 0 {
                return Ok(());
            }
            previous = run.pending.get(&head).map(|(state, clocks)| (state.clone(), clocks.total));
            if let Some((_, total)) = previous {
                run.bounds.push((head, Bound { number, rounds: round, cycles: total - begin }));
            }
            self.instruction(run, head)?;
            self.parts(run, &inner.body)?;
        }
        Ok(())
    }

    fn note_bounds(&mut self, run: &Run) {
        for (head, bound) in &run.bounds {
            let known = self.bounds.entry(*head).or_insert(*bound);
            known.rounds = known.rounds.max(bound.rounds);
            known.cycles = known.cycles.max(bound.cycles);
        }
    }

    /// A loop without a bound: it gets that of the annotations when the function is followed once
    /// more.
    fn no_bound(&mut self, run: &mut Run, function: &str, number: usize, head: u32) -> Result<u32> {
        let text = format!("{head:#x} in {function}: loop {number} has no bound");
        run.is_incomplete |= self.unbounded.insert(head);
        if !run.is_lenient {
            return Err(NoBound(text).into());
        }
        if self.analysis.annotations.bound(function, None).is_none() {
            self.missing.insert(text);
        }
        Ok(1)
    }

    fn instruction(&mut self, run: &mut Run, at: u32) -> Result<()> {
        let Some((state, clocks)) = run.pending.remove(&at) else { return Ok(()) };
        let instruction = self.program().instruction(at)?;
        for Step { flow, state: after, cycles } in step(self.program(), state.clone(), instruction)?
        {
            let mut clocks = clocks.clone();
            self.advance(run, &mut clocks, (&state, &after), at, cycles);
            match flow {
                Flow::To(to) if to == self.program().entry || to == 0 => {}
                Flow::To(to) => self.jump(run, at, to, after, clocks)?,
                Flow::Call(target, back) => {
                    self.call(run, at, target, Some(back), after, &clocks)?;
                }
                Flow::CallAnywhere(back) => {
                    for target in self.analysis.targets(at, "call")? {
                        self.call(run, at, target, Some(back), after.clone(), &clocks)?;
                    }
                }
                Flow::JumpAnywhere => {
                    for target in self.analysis.targets(at, "jump")? {
                        self.jump(run, at, target, after.clone(), clocks.clone())?;
                    }
                }
                Flow::Return | Flow::ReturnFromInterrupt => run.leave(after, clocks)?,
            }
        }
        Ok(())
    }

    /// Lets the time of an instruction pass, and notes the stretches that it ends.
    fn advance(
        &mut self,
        run: &mut Run,
        clocks: &mut Clocks,
        (before, after): (&State, &State),
        at: u32,
        cycles: u32,
    ) {
        clocks.total += cycles;
        for (index, watch) in self.watches.iter().enumerate() {
            let blocked = &mut clocks.blocked[index];
            if let Some((since, _)) = &mut blocked.own {
                *since += cycles;
            }
            if let Some(since) = &mut blocked.inherited {
                *since += cycles;
            }
            if watch.is_blocked(after) {
                if !watch.is_blocked(before) {
                    blocked.own = Some((cycles, at));
                }
                continue;
            }
            let Blocked { own, inherited } = std::mem::take(blocked);
            if let Some((since, begun)) = own {
                self.ended.note(index, begun, at, since);
            }
            if let Some(since) = inherited {
                run.time.ended[index] = run.time.ended[index].max(Some((since, at)));
            }
        }
    }

    fn jump(
        &mut self,
        run: &mut Run,
        at: u32,
        to: u32,
        state: State,
        clocks: Clocks,
    ) -> Result<()> {
        if run.summary.edges.contains(&(at, to)) {
            return run.reach(to, state, clocks);
        }
        // A jump to the beginning of another function, which returns to the caller.
        self.call(run, at, to, None, state, &clocks)
    }

    /// Follows a function that is called, or jumped to if `back` is `None`.
    fn call(
        &mut self,
        run: &mut Run,
        at: u32,
        target: u32,
        back: Option<u32>,
        caller: State,
        clocks: &Clocks,
    ) -> Result<()> {
        let entry = Entry::called(target, &caller);
        let time = self.enter(entry, &caller)?;
        for (index, ended) in time.ended.iter().enumerate() {
            let Some((cycles, end)) = ended else { continue };
            let Blocked { own, inherited } = clocks.blocked[index];
            if let Some((since, begun)) = own {
                self.ended.note(index, begun, *end, since + cycles);
            }
            if let Some(since) = inherited {
                let ended = Some((since + cycles, *end));
                run.time.ended[index] = run.time.ended[index].max(ended);
            }
        }
        let Some((exit, passed)) = &time.exit else { return Ok(()) };
        let mut clocks = clocks.clone();
        clocks.total += passed.total;
        for (mine, theirs) in clocks.blocked.iter_mut().zip(&passed.blocked) {
            let through = theirs.inherited;
            let own = mine.own.zip(through).map(|((since, at), more)| (since + more, at));
            mine.own = own.max(theirs.own);
            mine.inherited = mine.inherited.zip(through).map(|(since, more)| since + more);
        }
        let after = after_call(caller, exit);
        match back {
            Some(back) if run.summary.edges.contains(&(at, back)) => run.reach(back, after, clocks),
            Some(_) => Ok(()),
            None => run.leave(after, clocks),
        }
    }
}

impl Run {
    fn reach(&mut self, to: u32, state: State, clocks: Clocks) -> Result<()> {
        match self.pending.get_mut(&to) {
            Some((known, longest)) => {
                known.join(&state)?;
                longest.join(&clocks);
            }
            None => {
                self.pending.insert(to, (state, clocks));
            }
        }
        Ok(())
    }

    fn leave(&mut self, state: State, clocks: Clocks) -> Result<()> {
        join_exit(&mut self.time.exit, state, &clocks)
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
    fn join(&mut self, other: &Self) -> Result<()> {
        if let Some((state, clocks)) = &other.exit {
            join_exit(&mut self.exit, state.clone(), clocks)?;
        }
        for (mine, theirs) in self.ended.iter_mut().zip(&other.ended) {
            *mine = (*mine).max(*theirs);
        }
        Ok(())
    }
}

impl Loop {
    /// True if a path leads out of the loop.
    fn has_exit(&self, edges: &BTreeSet<(u32, u32)>) -> bool {
        edges.iter().any(|(from, to)| self.nodes.contains(from) && !self.nodes.contains(to))
    }
}

/// The register with the smallest range of several values that a function reads.
fn narrow_register(summary: &Summary, state: &State) -> Option<u8> {
    let width = |r: &u8| state.get(*r).hi - state.get(*r).lo;
    let read = (0..32u8).filter(|r| summary.reads >> r & 1 != 0);
    read.filter(|r| (1..MOST_VALUES).contains(&width(r))).min_by_key(width)
}

/// The state of the caller after a call.
fn after_call(mut caller: State, exit: &State) -> State {
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

/// Registers in the data space that an instruction reads, for loops that wait.
pub fn read_register(op: Op) -> Option<u16> {
    match op {
        Op::In(_, io) | Op::Sbic(io, _) | Op::Sbis(io, _) => Some(u16::from(io) + 0x20),
        Op::Lds(_, address) => Some(address),
        _ => None,
    }
}
