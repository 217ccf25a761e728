//! The longest path of a function in cycles: follows its paths in order, and each loop round by
//! round, with what is known of the registers, until no path goes back to its head.
//!
//! A function is followed once for each set of ranges of the registers that it reads. If a loop
//! has no bound then, and one of these ranges is small, each of its values is followed by itself.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt;
use std::rc::Rc;

use anyhow::{Result, anyhow, bail};

use crate::clock::{Blocked, Clocks, Ended, Kinds, Watch, keep_longer};
use crate::enables::Enables;
use crate::opcode::Op;
use crate::order::{Part, heads, parts};
use crate::path::{Bound, Open, Order, Run, Time, Told, Turn, after_call};
use crate::program::Program;
use crate::stack::{Analysis, is_restart};
use crate::state::{Interrupts, State, entry_half};
use crate::step::{Flow, Step, step};
use crate::summary::{Entry, Kind, Summary};
use crate::value::Value;

/// Instructions that are followed, before the analysis gives up.
const STEPS: u32 = 20_000_000;

/// I/O addresses of the pins, and of the data register of the SPI.
const PINB: u8 = 0x03;
const PINC: u8 = 0x06;
const PIND: u8 = 0x09;
const SPDR: u8 = 0x2E;

/// A register whose range has at most this width is followed value by value if that is of use.
const MOST_VALUES: u8 = 16;

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
    pub(crate) unbounded: BTreeSet<u32>,
    /// The loops with a bound, by the address of the head: how often they go back to it at most.
    pub bounds: BTreeMap<u32, Bound>,
    /// The loops whose rounds are not counted, by the address of the head.
    pub opens: BTreeMap<u32, Open>,
    /// What the annotations say that were used, by the first instruction of the loop.
    pub annotated: BTreeMap<u32, String>,
    /// The names of the annotations that were used.
    pub used: BTreeSet<String>,
    /// The loops of which an annotation tells the number of rounds, by the address of the head.
    pub told: BTreeMap<u32, Told>,
    /// The longest round of the largest endless loop so far.
    pub turn: Option<Turn>,
    /// For each endless loop, by the address of the head, and each function that it calls:
    /// cycles of its longest round with the call.
    pub(crate) through: BTreeMap<u32, BTreeMap<u32, u32>>,
    /// The functions of which a call tells the kind of a turn, by their addresses.
    pub(crate) kinds: BTreeMap<u32, Kinds>,
    /// For each endless loop, by the address of the head, and each set of kinds: cycles of its
    /// longest round of just these kinds.
    pub(crate) of_kinds: BTreeMap<u32, BTreeMap<Kinds, u32>>,
    /// Instructions that were followed.
    pub(crate) steps: u32,
    /// Heads of loops that took too many steps.
    pub(crate) too_long: BTreeSet<u32>,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Key {
    entry: Entry,
    /// Ranges of the registers that the function reads.
    ranges: Vec<(u8, u8)>,
    since_spdr: u8,
}

/// A loop has no bound.
#[derive(Debug)]
pub struct NoBound(pub String);

impl fmt::Display for NoBound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for NoBound {}

impl<'a, 'b> Timing<'a, 'b> {
    /// An analysis of the paths that `analysis` has found.
    pub fn new(analysis: &'b mut Analysis<'a>, watches: Vec<Watch>) -> Self {
        let kinds = analysis.annotations.kinds(analysis.program);
        Self {
            analysis,
            watches,
            results: HashMap::new(),
            orders: HashMap::new(),
            ended: Ended::default(),
            missing: BTreeSet::new(),
            unbounded: BTreeSet::new(),
            bounds: BTreeMap::new(),
            opens: BTreeMap::new(),
            annotated: BTreeMap::new(),
            used: BTreeSet::new(),
            told: BTreeMap::new(),
            turn: None,
            through: BTreeMap::new(),
            kinds,
            of_kinds: BTreeMap::new(),
            steps: 0,
            too_long: BTreeSet::new(),
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
        state.is_start = entry.kind == Kind::Reset;
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

    /// The parts of a function, in order.
    pub fn order(&mut self, entry: Entry, summary: &Summary) -> Rc<Order> {
        let order = self.orders.entry(entry).or_insert_with(|| {
            let parts = parts(&summary.edges, entry.address, summary.exit.is_none());
            Rc::new(Order { heads: heads(&parts), parts })
        });
        order.clone()
    }

    fn start(&mut self, entry: Entry, summary: &Rc<Summary>, at: u32, state: State) -> Run {
        let clocks = Clocks::at_entry(&self.watches, &state, !self.kinds.is_empty());
        Run {
            kind: entry.kind,
            summary: summary.clone(),
            order: self.order(entry, summary),
            pending: BTreeMap::from([(at, Box::new((state, clocks)))]),
            time: Time { ended: vec![None; self.watches.len()], ..Time::default() },
            is_lenient: false,
            is_incomplete: false,
            bounds: Vec::new(),
            opens: Vec::new(),
            turn: None,
            through: BTreeMap::new(),
            of_kinds: BTreeMap::new(),
        }
    }

    pub(crate) fn parts(&mut self, run: &mut Run, parts: &[Part]) -> Result<()> {
        for part in parts {
            match part {
                Part::Instruction(at) => self.instruction(run, *at)?,
                Part::Loop(inner) => self.rounds(run, inner)?,
            }
        }
        Ok(())
    }

    fn note_bounds(&mut self, run: &Run) {
        if let Some(turn) = run.turn {
            Turn::keep_larger(&mut self.turn, turn);
        }
        for (head, through) in &run.through {
            keep_longer(self.through.entry(*head).or_default(), through);
        }
        for (head, of_kinds) in &run.of_kinds {
            keep_longer(self.of_kinds.entry(*head).or_default(), of_kinds);
        }
        for (head, bound) in &run.bounds {
            let known = self.bounds.entry(*head).or_insert(*bound);
            known.rounds = known.rounds.max(bound.rounds);
            known.cycles = known.cycles.max(bound.cycles);
        }
        for (head, open) in &run.opens {
            let known = self.opens.entry(*head).or_insert_with(|| open.clone());
            known.cycles = known.cycles.max(open.cycles);
        }
    }

    pub(crate) fn instruction(&mut self, run: &mut Run, at: u32) -> Result<()> {
        let Some(pending) = run.pending.remove(&at) else { return Ok(()) };
        let (state, mut clocks) = *pending;
        self.steps += 1;
        if self.steps > STEPS {
            bail!("{}: the rounds of the loops are too many to follow", self.program().place(at));
        }
        let instruction = self.program().instruction(at)?;
        if instruction.op == Op::Sleep {
            clocks.never_end();
        }
        let before = (state.interrupts, state.enables);
        let steps = step(self.program(), &self.analysis.interference, state, instruction)?;
        // The last step takes the clocks themselves.
        let clocks = std::iter::repeat_n(clocks, steps.len());
        for (Step { flow, state: after, cycles, .. }, mut clocks) in steps.into_iter().zip(clocks) {
            self.advance(run, &mut clocks, before, &after, at, cycles);
            match instruction.op {
                Op::In(_, PINB | PINC | PIND)
                | Op::Sbic(PINB | PINC | PIND, _)
                | Op::Sbis(PINB | PINC | PIND, _) => clocks.looked.look(at),
                Op::Out(SPDR, _) => clocks.looked.transfer(),
                Op::Sbi(..) | Op::Cbi(..) => run.time.note_bit(at, clocks.total),
                _ => {}
            }
            match flow {
                Flow::To(to) if is_restart(self.program(), run.kind, to) => {
                    if clocks.opens == 0 {
                        run.time.restart = run.time.restart.max(Some(clocks.total));
                    }
                }
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
                Flow::Return => run.leave(after, &clocks)?,
                Flow::ReturnFromInterrupt => {
                    let mut after = after;
                    if run.kind.is_called() {
                        self.analysis.interference.apply(&mut after);
                    }
                    run.leave(after, &clocks)?;
                }
            }
        }
        Ok(())
    }

    /// Lets the time of an instruction pass, and notes the stretches that it ends.
    fn advance(
        &mut self,
        run: &mut Run,
        clocks: &mut Clocks,
        (interrupts, enables): (Interrupts, Enables),
        after: &State,
        at: u32,
        cycles: u32,
    ) {
        clocks.pass(cycles);
        for (index, watch) in self.watches.iter().enumerate() {
            let blocked = &mut clocks.blocked[index];
            if watch.is_blocked(after.interrupts, &after.enables) {
                let is_known = *blocked != Blocked::default();
                let may_begin = watch.is_surely_blocked(after.interrupts, &after.enables)
                    && !watch.is_surely_blocked(interrupts, &enables);
                if may_begin || !watch.is_blocked(interrupts, &enables) || !is_known {
                    blocked.own.insert(at, cycles);
                }
                continue;
            }
            let Blocked { own, inherited } = std::mem::take(blocked);
            for (begun, since) in own {
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
        mut clocks: Clocks,
    ) -> Result<()> {
        if run.summary.edges.contains(&(at, to)) {
            // A jump into another function counts as a call of it.
            if let Some(kinds) = self.kinds.get(&to) {
                clocks.call_kinds(*kinds, &vec![(0, 0)]);
            }
            if self.analysis.is_called(to) {
                run.time.calls.insert(to);
                if run.summary.exit.is_none() {
                    clocks.through.insert(to, clocks.total);
                }
            }
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
            let Blocked { own, inherited } = &clocks.blocked[index];
            for (begun, since) in own {
                self.ended.note(index, *begun, *end, since.saturating_add(*cycles));
            }
            if let Some(since) = inherited {
                let ended = Some((since.saturating_add(*cycles), *end));
                run.time.ended[index] = run.time.ended[index].max(ended);
            }
        }
        if let Some(cycles) = time.restart.filter(|_| clocks.opens == 0) {
            let total = clocks.total.saturating_add(cycles);
            run.time.restart = run.time.restart.max(Some(total));
        }
        for (at, cycles) in &time.bits {
            run.time.note_bit(*at, clocks.total.saturating_add(*cycles));
        }
        run.time.calls.insert(target);
        run.time.calls.extend(&time.calls);
        let Some((exit, passed)) = &time.exit else { return Ok(()) };
        let mut clocks = clocks.clone();
        clocks.total = clocks.total.saturating_add(passed.total);
        clocks.opens = clocks.opens.saturating_add(passed.opens);
        for since in clocks.through.values_mut() {
            *since = since.saturating_add(passed.total);
        }
        clocks.call_kinds(self.kinds.get(&target).copied().unwrap_or(0), &passed.of_kinds);
        if run.summary.exit.is_none() {
            let called = time.calls.iter().chain([&target]);
            clocks.through.extend(called.map(|function| (*function, clocks.total)));
        }
        clocks.looked.call(&passed.looked);
        for (mine, theirs) in clocks.blocked.iter_mut().zip(&passed.blocked) {
            let through = theirs.inherited;
            match through {
                Some(more) => {
                    mine.own.values_mut().for_each(|since| *since = since.saturating_add(more));
                }
                None => mine.own.clear(),
            }
            keep_longer(&mut mine.own, &theirs.own);
            mine.inherited =
                mine.inherited.zip(through).map(|(since, more)| since.saturating_add(more));
        }
        let mut after = after_call(caller, exit);
        let above = &self.analysis.function(entry)?.above;
        let pushed = if back.is_some() { 2 } else { 0 };
        after.forget_above(above, after.height() + pushed);
        match back {
            Some(back) if run.summary.edges.contains(&(at, back)) => run.reach(back, after, clocks),
            Some(_) => Ok(()),
            None => run.leave(after, &clocks),
        }
    }
}

/// The register with the smallest range of several values that a function reads.
fn narrow_register(summary: &Summary, state: &State) -> Option<u8> {
    let width = |r: &u8| state.get(*r).hi - state.get(*r).lo;
    let read = (0..32u8).filter(|r| summary.reads >> r & 1 != 0);
    read.filter(|r| (1..MOST_VALUES).contains(&width(r))).min_by_key(width)
}

/// Registers in the data space that an instruction reads, for loops that wait.
pub fn read_register(op: Op) -> Option<u16> {
    match op {
        Op::In(_, io) | Op::Sbic(io, _) | Op::Sbis(io, _) => Some(u16::from(io) + 0x20),
        Op::Lds(_, address) => Some(address),
        _ => None,
    }
}
