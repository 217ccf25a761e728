//! The times and the stack of a running program, to compare with what `bounds` proves: each
//! interrupt handler, each stretch with an interrupt blocked, each turn of the main loop. It looks
//! at every instruction.
//!
//! A handler takes from the response of the core to the end of RETI. A stretch takes from the
//! instruction that blocks, or the response, to the end of the instruction that ends it. The time
//! of a handler that interrupts another, a stretch or a turn does not count for these. A program
//! that begins elsewhere than at 0, a bootloader, is not observed while another one runs.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use bench::Cycles;
use bench::avr::{Avr, Moment};
use bounds::chip::INTERRUPTS;
use bounds::clock::Kinds;
use bounds::report::Report;
use bounds::times::{KindTime, ThroughTime, Times, TurnTime};

use crate::profile::VECTORS_END;

/// Cycles of the core's response to an interrupt.
const RESPONSE: Cycles = 4;
const RETI: u16 = 0x9518;

/// A stretch with an interrupt blocked: what is blocked, as `bounds` names it, and the addresses of
/// its first and last instruction.
pub type Stretch = (&'static str, u32, u32);

/// The longest that was seen, in cycles.
#[derive(Debug, Clone, Default)]
pub struct Observed {
    /// For each interrupt.
    pub handlers: BTreeMap<&'static str, u32>,
    /// For each stretch.
    pub stretches: BTreeMap<Stretch, u32>,
    /// The longest turn of the main loop.
    pub turn: u32,
    /// The longest turn in which a function is called, by its address.
    pub through: BTreeMap<u32, u32>,
    /// The longest turn of each set of kinds.
    pub of_kinds: BTreeMap<Kinds, u32>,
    /// For each loop of which an annotation tells the number of rounds, by its first instruction:
    /// how often it went back there, at most, each time it was reached.
    pub rounds: BTreeMap<u32, u32>,
    /// Number of turns.
    pub turns: u64,
    /// The longest time from the reset to the jump to 0 of a program that begins elsewhere.
    pub start: u32,
    /// The lowest stack pointer.
    pub lowest_sp: u16,
}

/// An interrupt whose blocked stretches are measured, or all.
struct Watch {
    name: &'static str,
    /// The register with the enable bit and the bit; `None` for all interrupts.
    enable: Option<(u16, u8)>,
}

impl Watch {
    fn named(name: &'static str) -> Self {
        let interrupt = INTERRUPTS.iter().find(|interrupt| interrupt.name == name);
        Self { name, enable: interrupt.map(|interrupt| interrupt.enable) }
    }

    fn is_blocked(&self, moment: &Moment, are_enabled: bool) -> bool {
        let is_masked = |(register, bit)| moment.data(register) >> bit & 1 == 0;
        !are_enabled || self.enable.is_some_and(is_masked)
    }
}

/// When a stretch began, the cycles of handlers that had interrupted until then, and its first
/// instruction.
type Begun = (Cycles, Cycles, Option<u32>);

/// What is measured of the main program, or of a handler.
#[derive(Clone)]
struct Level {
    /// Index of the interrupt; `None` for the main program.
    interrupt: Option<usize>,
    /// When it began, and the cycles of handlers that interrupted it.
    since: Cycles,
    nested: Cycles,
    /// For each watch: when the stretch began, `nested` then, and its first instruction. A stretch
    /// without a beginning began at the reset.
    stretches: Vec<Option<Begun>>,
    /// When the turn began, and `nested` then.
    turn: Option<(Cycles, Cycles)>,
    /// How often each loop has gone back since it was reached.
    rounds: BTreeMap<u32, u32>,
}

impl Level {
    fn new(interrupt: Option<usize>, since: Cycles, stretches: Vec<Option<Begun>>) -> Self {
        Self { interrupt, since, nested: 0, stretches, turn: None, rounds: BTreeMap::new() }
    }
}

struct State {
    flash: Vec<u8>,
    watches: Vec<Watch>,
    head: Option<u32>,
    /// Addresses of the functions that the main loop calls, and those called in this turn.
    functions: BTreeSet<u32>,
    called: BTreeSet<u32>,
    /// The functions that tell the kind of a turn, and the kinds of this one.
    kinds: BTreeMap<u32, Kinds>,
    turn_kinds: Kinds,
    /// For each loop of which an annotation tells the number of rounds, by its first instruction:
    /// the instructions that go back to it.
    loops: BTreeMap<u32, BTreeSet<u32>>,
    /// Address of the program's first instruction.
    entry: u32,
    /// When the program began; `None` while another one runs.
    began: Option<Cycles>,
    levels: Vec<Level>,
    before: Option<(u32, Cycles)>,
    observed: Observed,
}

impl State {
    fn opcode(&self, at: u32) -> u16 {
        let at = at as usize;
        u16::from_le_bytes([self.flash[at], self.flash[at + 1]])
    }

    /// Where the instruction at an address jumps to, if it is JMP or RJMP.
    fn jump(&self, at: u32) -> Option<u32> {
        match self.opcode(at) {
            0x940C => Some(u32::from(self.opcode(at + 2)) * 2),
            first if first & 0xF000 == 0xC000 => {
                let words = ((first << 4) as i16) >> 4;
                Some(at.wrapping_add(2).wrapping_add_signed(i32::from(words) * 2))
            }
            _ => None,
        }
    }

    fn level(&mut self) -> &mut Level {
        self.levels.last_mut().expect("the main program")
    }

    fn see(&mut self, moment: &Moment) {
        let (pc, sp, at) = (moment.pc(), moment.sp(), moment.at());
        let Some((last_pc, last_at)) = self.before.replace((pc, at)) else { return };
        let last = self.opcode(last_pc);
        // Also by the vector of an interrupt without a handler, or by a handler that does not end.
        let is_interrupted = last_pc < VECTORS_END || self.levels.len() > 1;
        if pc == self.entry || is_interrupted && self.jump(self.entry) == Some(pc) {
            self.began = Some(at);
            self.start();
            return;
        }
        if pc == 0
            && let Some(began) = self.began.take()
        {
            self.observed.start = self.observed.start.max((at - began) as u32);
        }
        if self.began.is_none() {
            return;
        }
        if pc < VECTORS_END && last_pc >= VECTORS_END {
            // They were enabled before the response.
            self.watch(moment, true, at - RESPONSE, (last_pc, last_at));
            self.enter(moment);
            return;
        }
        if let Level { interrupt: Some(_), stretches, .. } = self.level()
            && last_pc < VECTORS_END
        {
            // The first instruction behind the vector.
            for (_, _, begins) in stretches.iter_mut().flatten() {
                *begins = begins.or(Some(pc));
            }
        }
        self.watch(moment, moment.interrupts_enabled(), at, (last_pc, last_at));
        if last == RETI && self.levels.len() > 1 {
            self.leave(at);
        }
        if let Some(backs) = self.loops.get(&pc) {
            // Where an interrupt came between the two, it counts as reached anew.
            let goes_back = backs.contains(&last_pc);
            let level = self.levels.last_mut().expect("the main program");
            let rounds = level.rounds.entry(pc).or_default();
            *rounds = if goes_back { *rounds + 1 } else { 0 };
            let most = self.observed.rounds.entry(pc).or_default();
            *most = (*most).max(*rounds);
        }
        // PUSH, CALL, RCALL, ICALL, OUT SPL. Else SP can be between the writes of its halves.
        let moved = last & 0xFE0F == 0x920F
            || last & 0xFE0E == 0x940E
            || last & 0xF000 == 0xD000
            || last == 0x9509
            || last & 0xFE0F == 0xBE0D;
        if moved {
            self.observed.lowest_sp = self.observed.lowest_sp.min(sp);
        }
        if self.levels.len() == 1 {
            if self.head == Some(pc) {
                self.turn(at);
            } else if self.functions.contains(&pc) {
                self.called.insert(pc);
            }
            self.turn_kinds |= self.kinds.get(&pc).copied().unwrap_or(0);
        }
    }

    /// A reset, or a restart.
    fn start(&mut self) {
        let stretches = self.watches.iter().map(|_| Some((0, 0, None))).collect();
        self.levels = vec![Level::new(None, 0, stretches)];
    }

    fn enter(&mut self, moment: &Moment) {
        let since = moment.at() - RESPONSE;
        // Of a vector that contains other code than a jump the handler begins there.
        let begins = self.jump(moment.pc()).is_none().then_some(moment.pc());
        let stretches = self.watches.iter().map(|_| Some((since, 0, begins))).collect();
        let interrupt = Some(moment.pc() as usize / 4 - 1);
        self.observed.lowest_sp = self.observed.lowest_sp.min(moment.sp());
        self.levels.push(Level::new(interrupt, since, stretches));
    }

    fn leave(&mut self, at: Cycles) {
        let Some(Level { interrupt, since, nested, .. }) = self.levels.pop() else { return };
        let name = INTERRUPTS[interrupt.unwrap_or(0)].name;
        let longest = self.observed.handlers.entry(name).or_default();
        *longest = (*longest).max((at - since - nested) as u32);
        self.level().nested += at - since;
    }

    /// Begins and ends stretches, after the instruction at `last_pc` that took from `last_at` to
    /// `at`.
    fn watch(
        &mut self,
        moment: &Moment,
        are_enabled: bool,
        at: Cycles,
        (last_pc, last_at): (u32, Cycles),
    ) {
        let level = self.levels.last_mut().expect("the main program");
        let handler = level.interrupt.map(|interrupt| INTERRUPTS[interrupt].name);
        for (watch, stretch) in self.watches.iter().zip(&mut level.stretches) {
            // The handler of another interrupt is a stretch without interrupts only.
            if watch.enable.is_some() && handler.is_some_and(|handler| handler != watch.name) {
                continue;
            }
            match (watch.is_blocked(moment, are_enabled), *stretch) {
                (true, None) => *stretch = Some((last_at, level.nested, Some(last_pc))),
                (false, Some((since, nested, begins))) => {
                    *stretch = None;
                    let Some(begins) = begins else { continue };
                    let cycles = at - since - (level.nested - nested);
                    let seen = self.observed.stretches.entry((watch.name, begins, last_pc));
                    let longest = seen.or_default();
                    *longest = (*longest).max(cycles as u32);
                }
                _ => {}
            }
        }
    }

    fn turn(&mut self, at: Cycles) {
        let level = self.levels.last_mut().expect("the main program");
        if let Some((since, nested)) = level.turn.replace((at, level.nested)) {
            let cycles = at - since - (level.nested - nested);
            self.observed.turn = self.observed.turn.max(cycles as u32);
            self.observed.turns += 1;
            for function in &self.called {
                let longest = self.observed.through.entry(*function).or_default();
                *longest = (*longest).max(cycles as u32);
            }
            let longest = self.observed.of_kinds.entry(self.turn_kinds).or_default();
            *longest = (*longest).max(cycles as u32);
        }
        self.called.clear();
        self.turn_kinds = 0;
    }
}

/// Observes a running program.
pub struct Observer {
    state: Rc<RefCell<State>>,
}

impl Observer {
    /// Observes what has been proved. Call it before the program starts, or later.
    pub fn begin(avr: &mut Avr, proved: &Times) -> Self {
        let mut names: Vec<&str> = proved.stretches.iter().map(|stretch| stretch.blocks).collect();
        names.dedup();
        let mut state = State {
            flash: avr.flash().to_vec(),
            watches: names.into_iter().map(Watch::named).collect(),
            head: proved.turn.as_ref().map(|turn| turn.head),
            functions: proved
                .turn
                .iter()
                .flat_map(|turn| turn.through.iter().map(|function| function.address))
                .collect(),
            called: BTreeSet::new(),
            kinds: proved.turn.as_ref().map_or(BTreeMap::new(), |turn| turn.kinds.clone()),
            turn_kinds: 0,
            loops: proved.told.iter().map(|(head, told)| (*head, told.backs.clone())).collect(),
            entry: proved.entry,
            began: Some(0),
            levels: Vec::new(),
            before: None,
            observed: Observed { lowest_sp: u16::MAX, ..Observed::default() },
        };
        state.start();
        let state = Rc::new(RefCell::new(state));
        let seen = state.clone();
        avr.trace(Some(Box::new(move |moment| seen.borrow_mut().see(moment))));
        Self { state }
    }

    /// What was seen so far.
    pub fn observed(&self) -> Observed {
        self.state.borrow().observed.clone()
    }
}

/// How the figures of the turns with a call of a function begin.
pub const WITH_CALL: &str = "turn with a call of";

/// How the rounds of loops begin of which an annotation tells the number.
pub const ROUNDS: &str = "rounds of ";

/// How the figures of the turns of certain kinds begin.
pub const OF_KINDS: &str = "turn: ";

/// A figure that was proved, and the longest that was seen.
#[derive(Debug, Clone)]
pub struct Pair {
    /// What it is.
    pub name: String,
    /// Cycles or bytes.
    pub proved: u32,
    /// Cycles or bytes.
    pub observed: u32,
}

impl Observed {
    /// The figures beside those that were proved. A stretch that was seen and not proved has the
    /// proof 0.
    pub fn beside(&self, report: &Report) -> Vec<Pair> {
        let mut pairs = Vec::new();
        let mut add = |name: String, proved: u32, observed: u32| {
            pairs.push(Pair { name, proved, observed });
        };
        let base = u32::from(report.stack.base);
        let deepest = base.saturating_sub(u32::from(self.lowest_sp));
        add("stack".into(), report.stack.bytes, deepest);
        let Some(times) = &report.times else { return pairs };
        for (name, observed) in &self.handlers {
            let proved = times.handlers.iter().find(|handler| handler.interrupt == *name);
            let proved = proved.map_or(0, |handler| handler.cycles.0);
            add(format!("handler of {name}"), proved, *observed);
        }
        for ((name, from, to), observed) in &self.stretches {
            // Of several ends of a stretch the proof has the last.
            let of_same = times
                .stretches
                .iter()
                .filter(|stretch| stretch.blocks == *name && stretch.from == *from);
            let proved = of_same.max_by_key(|stretch| stretch.cycles);
            if proved.is_none() && times.partly_enabled.contains(name) {
                continue;
            }
            let place = proved.map_or(String::new(), |stretch| stretch.begins.clone());
            let proved = proved.map_or(0, |stretch| stretch.cycles.0);
            add(format!("{name} blocked, {from:#x} to {to:#x} {place}"), proved, *observed);
        }
        for (head, told) in &times.told {
            let observed = self.rounds.get(head).copied().unwrap_or(0);
            let name = format!("{ROUNDS}{head:#x}, loop {}", told.number);
            add(name, told.at_most, observed);
        }
        if let Some(start) = &times.start {
            add("from the reset to the program".into(), start.0, self.start);
        }
        if let Some(turn) = &times.turn {
            add("turn of the main loop".into(), turn.cycles.0, self.turn);
            for ThroughTime { function, address, cycles } in &turn.through {
                let observed = self.through.get(address).copied().unwrap_or(0);
                add(format!("{WITH_CALL} {function}"), cycles.0, observed);
            }
            for (kinds, observed) in self.beside_kinds(turn) {
                let proved = turn.of_kinds.iter().find(|time| time.kinds == kinds);
                let names = proved.map_or("unknown".into(), name_of_kinds);
                let proved = proved.map_or(0, |time| time.cycles.0);
                add(format!("{OF_KINDS}{names}"), proved, observed);
            }
        }
        pairs
    }

    /// The longest turn of each set of kinds that was proved or seen.
    fn beside_kinds(&self, turn: &TurnTime) -> BTreeMap<Kinds, u32> {
        let mut all: BTreeMap<Kinds, u32> =
            turn.of_kinds.iter().map(|time| (time.kinds, 0)).collect();
        if !all.is_empty() {
            all.extend(&self.of_kinds);
        }
        all
    }
}

fn name_of_kinds(time: &KindTime) -> String {
    if time.names.is_empty() { "no kind".into() } else { time.names.join(" + ") }
}
