//! The depth of the stack of a function: follows all its paths, and those of the functions that it
//! calls, until nothing new is found.
//!
//! A function is analysed once for each state of the I flag and of the interrupt enable bits with
//! which it is called. Its registers are unknown then, so the result is true for each call. A jump
//! to the beginning of another function with an empty stack is a call that returns to the caller;
//! every other jump stays in the function.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::fmt;
use std::rc::Rc;

use anyhow::{Context as _, Result, bail};

use crate::annotations::Annotations;
use crate::interference::Interference;
use crate::memory::Written;
use crate::opcode::Op;
use crate::program::Program;
use crate::state::State;
use crate::step::{Flow, is_table_jump, step};
use crate::summary::{Entry, Exit, Kind, Summary, Vector, reset};
use crate::value::Value;
use crate::virtuals;

/// Joins before which ranges grow as far as they go.
const JOINS_BEFORE_WIDENING: u32 = 6;

/// Instructions of a function that are followed, before the analysis gives up.
const STEPS: u32 = 2_000_000;

/// The analysis of a program.
pub struct Analysis<'a> {
    /// The program.
    pub program: &'a Program,
    /// What the analysis cannot find.
    pub annotations: &'a Annotations,
    /// What the handlers change. [`crate::whole::settle`] finds it.
    pub interference: Interference,
    /// The vectors that count. [`crate::whole::settle`] finds them.
    pub vectors: Option<Vec<Vector>>,
    /// How the program begins after a reset.
    pub reset: Entry,
    /// What is assumed of instructions, and where.
    pub assumed: Assumed,
    /// Stores to fixed addresses of the RAM: the address, and the first instruction.
    pub stores: BTreeMap<u16, u32>,
    summaries: HashMap<Entry, Rc<Summary>>,
    /// The addresses of the functions that are called.
    called: HashSet<u32>,
    leaders: Rc<HashSet<u32>>,
    active: Vec<u32>,
}

/// Instructions of which something is assumed, by their addresses.
#[derive(Debug, Clone, Default)]
pub struct Assumed {
    /// Stores through pointers.
    pub stores: BTreeSet<u32>,
    /// SPM.
    pub spm: BTreeSet<u32>,
    /// BREAK.
    pub breaks: BTreeSet<u32>,
    /// Indirect calls and jumps with an annotation.
    pub indirect: BTreeSet<u32>,
    /// Calls of virtual functions.
    pub virtual_calls: BTreeSet<u32>,
}

/// A function whose paths are followed.
struct Walk {
    entry: Entry,
    /// Addresses at which paths can meet.
    leaders: Rc<HashSet<u32>>,
    /// Instructions that have one predecessor: their states need not be kept.
    straight: Vec<(u32, State)>,
    states: BTreeMap<u32, (State, u32)>,
    pending: BTreeSet<u32>,
    summary: Summary,
    /// A target was found at which paths were not expected to meet.
    has_new_leader: bool,
}

/// An error with the place where it is.
#[derive(Debug)]
struct Placed(String);

impl fmt::Display for Placed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Placed {}

impl<'a> Analysis<'a> {
    /// An analysis that knows nothing yet.
    pub fn new(program: &'a Program, annotations: &'a Annotations) -> Self {
        Self {
            program,
            annotations,
            interference: Interference::default(),
            vectors: None,
            reset: reset(program),
            assumed: Assumed::default(),
            stores: BTreeMap::new(),
            summaries: HashMap::new(),
            called: HashSet::new(),
            leaders: Rc::new(program.leaders()),
            active: Vec::new(),
        }
    }

    /// Forgets what was found without something that is known now.
    pub(crate) fn forget(&mut self) {
        self.summaries.clear();
        self.called.clear();
    }

    /// True if a function that is called begins at an address. A jump may lead there, too.
    pub(crate) fn is_called(&self, address: u32) -> bool {
        self.called.contains(&address)
    }

    /// Analyses a function with all that it calls.
    ///
    /// # Errors
    /// If a path cannot be followed; the text says where and why.
    pub fn function(&mut self, entry: Entry) -> Result<Rc<Summary>> {
        if let Some(known) = self.summaries.get(&entry) {
            return Ok(known.clone());
        }
        if let Some(first) = self.active.iter().position(|address| *address == entry.address) {
            let chain: Vec<String> = self.active[first..]
                .iter()
                .chain([&entry.address])
                .map(|address| self.program.function_name(*address))
                .collect();
            bail!(
                "recursion: {}: the stack has no bound, so call in a loop instead",
                chain.join(" -> ")
            );
        }
        self.active.push(entry.address);
        let summary = self.walk(entry);
        self.active.pop();
        let summary = Rc::new(summary?);
        self.summaries.insert(entry, summary.clone());
        if entry.kind.is_called() {
            self.called.insert(entry.address);
        }
        Ok(summary)
    }

    fn walk(&mut self, entry: Entry) -> Result<Summary> {
        loop {
            let walk = self.walk_once(entry)?;
            if !walk.has_new_leader {
                return Ok(walk.summary);
            }
        }
    }

    fn walk_once(&mut self, entry: Entry) -> Result<Walk> {
        let mut state = State::at_entry(entry.interrupts, entry.enables);
        if entry.kind == (Kind::Called { with_zero: true }) {
            state.set(1, Value::ZERO);
        }
        state.is_start = entry.kind == Kind::Reset;
        let mut walk = Walk {
            entry,
            leaders: self.leaders.clone(),
            straight: Vec::new(),
            states: BTreeMap::from([(entry.address, (state, 0))]),
            pending: BTreeSet::from([entry.address]),
            summary: Summary::default(),
            has_new_leader: false,
        };
        let mut steps = 0;
        while let Some((at, state)) = walk.next() {
            steps += 1;
            if steps > STEPS {
                bail!("{}: the paths are too many", self.program.place(entry.address));
            }
            self.follow(&mut walk, at, state).map_err(|error| self.placed(error, at))?;
        }
        let states = std::mem::take(&mut walk.states);
        walk.summary.states = states.into_iter().map(|(at, (state, _))| (at, state)).collect();
        let Summary { edges, calls, .. } = &walk.summary;
        walk.summary.reads = crate::liveness::reads(self.program, edges, calls, entry.address);
        Ok(walk)
    }

    /// Adds the place to an error that has none yet.
    fn placed(&self, error: anyhow::Error, at: u32) -> anyhow::Error {
        if error.is::<Placed>() {
            error
        } else {
            Placed(format!("{}: {error:#}", self.program.place(at))).into()
        }
    }

    fn follow(&mut self, walk: &mut Walk, at: u32, state: State) -> Result<()> {
        walk.summary.visit(&state, at);
        let instruction = self.program.instruction(at)?;
        for step in step(self.program, &self.interference, state, instruction)? {
            self.note(walk, at, instruction.op, &step.written)?;
            match step.flow {
                Flow::To(to) => self.jump(walk, at, to, step.state, instruction.next())?,
                Flow::Call(target, back) => self.call(walk, at, &[target], back, step.state)?,
                Flow::CallAnywhere(back) => {
                    let targets = self.targets(at, "call")?;
                    self.assume_targets(at);
                    self.call(walk, at, &targets, back, step.state)?;
                }
                Flow::JumpAnywhere => {
                    let targets = self.targets(at, "jump")?;
                    self.assume_targets(at);
                    for target in targets {
                        self.jump(walk, at, target, step.state.clone(), instruction.next())?;
                    }
                }
                Flow::Return => self.leave(walk, &step.state, false)?,
                Flow::ReturnFromInterrupt => {
                    let mut state = step.state;
                    // A function that is called and ends so.
                    if walk.entry.kind.is_called() {
                        self.interference.apply(&mut state);
                    }
                    self.leave(walk, &state, true)?;
                }
            }
        }
        Ok(())
    }

    /// Notes what an instruction writes, and what is assumed of it.
    fn note(&mut self, walk: &mut Walk, at: u32, op: Op, written: &Written) -> Result<()> {
        walk.summary.note(written);
        if let Some(address) = written.ram {
            self.stores.entry(address).or_insert(at);
        }
        if written.is_anywhere {
            self.assumed.stores.insert(at);
        }
        match op {
            Op::Spm => drop(self.assumed.spm.insert(at)),
            Op::Break => drop(self.assumed.breaks.insert(at)),
            _ => {}
        }
        if written.above.is_some() {
            self.check_above(walk)?;
        }
        Ok(())
    }

    /// A function may store to the part of its caller, which has put arguments there.
    fn check_above(&self, walk: &Walk) -> Result<()> {
        if !walk.summary.above.is_empty() && !walk.entry.kind.is_called() {
            bail!("a store above the stack of a handler, or of the start of the program");
        }
        Ok(())
    }

    /// The targets of an indirect call or jump: from the annotations, or of a virtual call.
    pub(crate) fn targets(&self, at: u32, what: &str) -> Result<Vec<u32>> {
        let function = self.program.function_name(at);
        let named = self.annotations.targets(self.program, &function)?;
        named.or_else(|| virtuals::targets(self.program, &self.leaders, at)).with_context(|| {
            format!(
                "an indirect {what} whose targets are not known: name them in an [[indirect]] of \
                 {function} in a file for --annotations:\n\n[[indirect]]\nfunction = \
                 \"{function}\"\ntargets = [\"each function that it may {what}\"]\nreason = \
                 \"why these are all\"\n"
            )
        })
    }

    /// Notes what is assumed of the targets of an indirect call or jump.
    fn assume_targets(&mut self, at: u32) {
        let function = self.program.function_name(at);
        let is_named = self.annotations.indirect.iter().any(|entry| entry.function == function);
        let assumed = &mut self.assumed;
        if is_named { &mut assumed.indirect } else { &mut assumed.virtual_calls }.insert(at);
    }

    fn jump(&mut self, walk: &mut Walk, at: u32, to: u32, state: State, next: u32) -> Result<()> {
        if is_restart(self.program, walk.entry.kind, to) {
            walk.summary.restarts |= to != 0 || self.program.entry == 0;
            walk.summary.restarts_enabled |= state.interrupts.may_happen();
            return Ok(());
        }
        // Other jumps go to leaders.
        if to != next && !self.leaders.contains(&to) {
            Rc::make_mut(&mut self.leaders).insert(to);
            walk.has_new_leader = true;
        }
        let is_other_function = to != next
            && to != walk.entry.address
            && self.program.is_function(to)
            && !is_table_jump(self.program, to)
            && !walk.states.contains_key(&to);
        if is_other_function && state.height() == 0 && walk.entry.kind.is_called() {
            let summary = self.enter(walk, at, to, &state, 0)?;
            if let Some(exit) = &summary.exit {
                let mut state = state;
                exit.apply(&mut state);
                self.above(walk, &summary, &mut state, 0)?;
                self.leave(walk, &state, false)?;
            }
            return Ok(());
        }
        walk.summary.edges.insert((at, to));
        walk.reach(to, state)
    }

    fn call(
        &mut self,
        walk: &mut Walk,
        at: u32,
        targets: &[u32],
        back: u32,
        state: State,
    ) -> Result<()> {
        for target in targets {
            let summary = self.enter(walk, at, *target, &state, 2)?;
            if let Some(exit) = &summary.exit {
                let mut after = state.clone();
                exit.apply(&mut after);
                self.above(walk, &summary, &mut after, 2)?;
                walk.summary.edges.insert((at, back));
                walk.reach(back, after)?;
            }
        }
        Ok(())
    }

    /// Forgets what a function that was called has stored in the part of its caller.
    fn above(
        &self,
        walk: &mut Walk,
        callee: &Summary,
        state: &mut State,
        pushed: u32,
    ) -> Result<()> {
        for offset in state.forget_above(&callee.above, state.height() + pushed) {
            if matches!(offset, 1 | 2) {
                bail!("a function that is called overwrites the return address");
            }
            walk.summary.above.insert(offset);
        }
        self.check_above(walk)
    }

    /// Analyses a function that is called, and counts its stack. `pushed` are the bytes of the
    /// return address.
    fn enter(
        &mut self,
        walk: &mut Walk,
        at: u32,
        target: u32,
        state: &State,
        pushed: u32,
    ) -> Result<Rc<Summary>> {
        let entry = Entry::called(target, state);
        let summary = self.function(entry)?;
        walk.summary.count(state.height() + pushed, entry, &summary);
        if state.base.is_none() {
            let deepest = state.height() + pushed + summary.depth.bytes;
            walk.summary.before_base = walk.summary.before_base.max(deepest);
        }
        *walk.summary.calls.entry(at).or_default() |= summary.reads;
        Ok(summary)
    }

    fn leave(&mut self, walk: &mut Walk, state: &State, from_interrupt: bool) -> Result<()> {
        match (walk.entry.kind, from_interrupt) {
            (Kind::Handler, false) => bail!("the handler ends with RET: interrupts stay disabled"),
            (Kind::Reset, _) => bail!("returns from the start of the program"),
            _ => {}
        }
        let exit = Exit::of(walk.entry, state);
        match &mut walk.summary.exit {
            Some(known) => known.join(&exit),
            none => *none = Some(exit),
        }
        Ok(())
    }
}

/// True if a jump leads to the start of the program, or of a bootloader to the program at 0.
pub fn is_restart(program: &Program, kind: Kind, to: u32) -> bool {
    to == program.entry || to == 0 || to == program.start() && kind != Kind::Reset
}

impl Walk {
    /// The next instruction to follow, with its state.
    fn next(&mut self) -> Option<(u32, State)> {
        self.straight.pop().or_else(|| {
            let at = self.pending.pop_first()?;
            Some((at, self.states[&at].0.clone()))
        })
    }

    /// Adds a state at an instruction.
    fn reach(&mut self, at: u32, state: State) -> Result<()> {
        if let Some(base) = state.base {
            if self.summary.base.is_some_and(|known| known != base) {
                bail!("SP is set to {base:#x}, and elsewhere to another constant");
            }
            self.summary.base = Some(base);
        }
        if !self.leaders.contains(&at) {
            self.straight.push((at, state));
            return Ok(());
        }
        let Some((known, joins)) = self.states.get_mut(&at) else {
            self.states.insert(at, (state, 0));
            self.pending.insert(at);
            return Ok(());
        };
        let mut joined = known.clone();
        joined.join(&state)?;
        if *joins > JOINS_BEFORE_WIDENING {
            joined.widen(known);
        }
        if joined != *known {
            *known = joined;
            *joins += 1;
            self.pending.insert(at);
        }
        Ok(())
    }
}
