//! Profiles the running program from outside: the duration of a turn of the main loop and of its
//! parts, and the greatest stack depth with the calls that led to it. It looks at every
//! instruction; names come from the ELF's debugging information.

use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::path::Path;
use std::rc::Rc;

use addr2line::Loader;
use bench::Cycles;
use bench::avr::{Avr, Moment};

/// Opcode of WDR, which resets the watchdog once a turn.
const WDR: u16 = 0x95A8;
/// Turns of which [`Profile::recent`] tells.
const RECENT: usize = 12;
/// End of the interrupt vectors, a byte address.
pub(crate) const VECTORS_END: u32 = 0x68;

/// A call that has not returned.
#[derive(Clone, Copy, Debug)]
pub struct Call {
    /// Byte address of the calling instruction, or of the interrupt's vector.
    pub from: u32,
    /// Byte address of the called function.
    pub to: u32,
    /// Stack pointer in the called function.
    pub sp: u16,
}

/// An instruction of a turn.
#[derive(Clone, Copy, Debug)]
struct Step {
    at: Cycles,
    /// Address in the main function: the call there, or the instruction itself.
    in_main: u32,
    /// Address of the function that is called there.
    called: Option<u32>,
    pc: u32,
}

#[derive(Default)]
struct State {
    flash: Vec<u8>,
    /// True after the first WDR of the main loop.
    in_loop: bool,
    calls: Vec<Call>,
    before: Option<(u32, u16)>,
    turn: Vec<Step>,
    turns: u64,
    /// The last turns, oldest first.
    recent: VecDeque<Vec<Step>>,
    worst: Vec<Step>,
    worst_cycles: Cycles,
    sum: Cycles,
    deepest_sp: u16,
    deepest: Vec<Call>,
}

impl State {
    fn opcode(&self, at: u32) -> u16 {
        let at = at as usize;
        u16::from_le_bytes([self.flash[at], self.flash[at + 1]])
    }

    fn see(&mut self, moment: &Moment) {
        let (pc, sp, at) = (moment.pc(), moment.sp(), moment.at());
        if let Some((last_pc, last_sp)) = self.before.replace((pc, sp)) {
            let last = self.opcode(last_pc);
            // CALL, RCALL, ICALL.
            let called = last & 0xFE0E == 0x940E || last & 0xF000 == 0xD000 || last == 0x9509;
            let interrupted = pc < VECTORS_END && last_pc >= VECTORS_END && sp < last_sp;
            if interrupted {
                self.calls.push(Call { from: pc, to: pc, sp });
            } else if called && sp < last_sp {
                self.calls.push(Call { from: last_pc, to: pc, sp });
            } else if matches!(last, 0x9508 | 0x9518) {
                // RET, RETI.
                while self.calls.last().is_some_and(|call| call.sp < sp) {
                    self.calls.pop();
                }
            }
            // PUSH and OUT SPL. Between the writes of SPH and SPL the stack pointer is invalid.
            let moved = called || interrupted || last & 0xFE0F == 0x920F || last & 0xFE0F == 0xBE0D;
            if self.in_loop && moved && sp < self.deepest_sp {
                self.deepest_sp = sp;
                self.deepest = self.calls.clone();
                self.deepest.push(Call { from: pc, to: pc, sp });
            }
        }
        if self.opcode(pc) == WDR {
            self.end_turn(at);
        }
        if self.in_loop {
            let call = self.calls.first();
            let in_main = call.map_or(pc, |call| call.from);
            self.turn.push(Step { at, in_main, called: call.map(|call| call.to), pc });
        }
    }

    fn end_turn(&mut self, at: Cycles) {
        self.in_loop = true;
        self.calls.clear();
        if let Some(first) = self.turn.first() {
            let cycles = at - first.at;
            self.turns += 1;
            self.sum += cycles;
            self.turn.push(Step { at, in_main: 0, called: None, pc: 0 });
            if cycles > self.worst_cycles {
                self.worst_cycles = cycles;
                self.worst.clone_from(&self.turn);
            }
            if self.recent.len() == RECENT {
                self.recent.pop_front();
            }
            self.recent.push_back(std::mem::take(&mut self.turn));
        }
        self.turn.clear();
    }
}

/// A profile of a running program.
pub struct Profile {
    state: Rc<RefCell<State>>,
}

/// Cycles spent in one function or task.
#[derive(Clone, Debug)]
pub struct Share {
    pub name: String,
    pub cycles: Cycles,
}

impl Profile {
    /// Starts to profile a program that is in its main loop. The first turn starts at the next
    /// reset of the watchdog.
    pub fn begin(avr: &mut Avr) -> Profile {
        let state = State { flash: avr.flash().to_vec(), deepest_sp: u16::MAX, ..State::default() };
        let state = Rc::new(RefCell::new(state));
        let seen = Rc::clone(&state);
        avr.trace(Some(Box::new(move |moment| seen.borrow_mut().see(moment))));
        Profile { state }
    }

    /// Number of turns; mean and longest turn in cycles.
    pub fn turns(&self) -> (u64, Cycles, Cycles) {
        let state = self.state.borrow();
        (state.turns, state.sum / state.turns.max(1), state.worst_cycles)
    }

    /// The longest turn by what the main function calls, longest share first.
    pub fn tasks(&self, names: &Names) -> Vec<Share> {
        self.shares(|step| names.task(step))
    }

    /// The last turns, oldest first: each with what the main function calls, longest share first.
    pub fn recent(&self, names: &Names) -> Vec<Vec<Share>> {
        let state = self.state.borrow();
        state.recent.iter().map(|turn| shares(turn, |step| names.task(step))).collect()
    }

    /// The longest turn, in the order of execution.
    pub fn course(&self, names: &Names) -> Vec<Share> {
        let state = self.state.borrow();
        let mut course: Vec<Share> = Vec::new();
        for pair in state.worst.windows(2) {
            let (name, cycles) = (names.task(&pair[0]), pair[1].at - pair[0].at);
            match course.last_mut() {
                Some(last) if last.name == name => last.cycles += cycles,
                _ => course.push(Share { name, cycles }),
            }
        }
        course
    }

    /// The longest turn by the innermost function, longest share first.
    pub fn functions(&self, names: &Names) -> Vec<Share> {
        self.shares(|step| names.functions(step.pc).into_iter().next().unwrap_or_default())
    }

    fn shares(&self, name: impl Fn(&Step) -> String) -> Vec<Share> {
        shares(&self.state.borrow().worst, name)
    }

    /// The lowest stack pointer, and the calls that led to it, outermost first.
    pub fn deepest(&self) -> (u16, Vec<Call>) {
        let state = self.state.borrow();
        (state.deepest_sp, state.deepest.clone())
    }
}

/// The cycles of a turn by name, longest share first.
fn shares(turn: &[Step], name: impl Fn(&Step) -> String) -> Vec<Share> {
    let mut shares: BTreeMap<String, Cycles> = BTreeMap::new();
    for pair in turn.windows(2) {
        *shares.entry(name(&pair[0])).or_default() += pair[1].at - pair[0].at;
    }
    let mut shares: Vec<Share> =
        shares.into_iter().map(|(name, cycles)| Share { name, cycles }).collect();
    shares.sort_by_key(|share| std::cmp::Reverse(share.cycles));
    shares
}

/// Names of functions by address.
pub struct Names {
    loader: Loader,
    known: RefCell<HashMap<u32, Vec<String>>>,
}

impl Names {
    /// The names in the node's ELF.
    pub fn of_node() -> Names {
        Names::of(&super::Program::Preset.elf())
    }

    /// The names in this ELF.
    pub fn of(elf: &Path) -> Names {
        let loader = Loader::new(elf)
            .unwrap_or_else(|error| panic!("debugging information of the ELF: {error}"));
        Names { loader, known: RefCell::default() }
    }

    /// The function at an address, then the one that it is inlined in, and so on.
    pub fn functions(&self, pc: u32) -> Vec<String> {
        if let Some(known) = self.known.borrow().get(&pc) {
            return known.clone();
        }
        let symbol = self.loader.find_symbol(pc.into()).unwrap_or_default();
        let mut names = Vec::new();
        let mut outermost = String::new();
        if let Ok(mut frames) = self.loader.find_frames(pc.into()) {
            while let Ok(Some(frame)) = frames.next() {
                let Some(function) = frame.function else { continue };
                outermost = function.raw_name().map(|name| name.into_owned()).unwrap_or_default();
                names.extend(function.demangle().map(|name| short(&name)));
            }
        }
        // The linker leaves functions that it removed in the debugging information, at address 0.
        if outermost != symbol && !symbol.is_empty() && !symbol.starts_with("__vector") {
            names = vec![symbol.to_owned()];
        }
        self.known.borrow_mut().insert(pc, names.clone());
        names
    }

    /// The function whose code is at an address, regardless of inlining.
    pub fn function(&self, pc: u32) -> String {
        if pc < VECTORS_END {
            return "an interrupt".to_owned();
        }
        let functions = self.functions(pc);
        functions.into_iter().rev().find(|name| !name.starts_with("__vector")).unwrap_or_default()
    }

    /// What the main function executes: the function that it calls, the one that is inlined there,
    /// or itself.
    fn task(&self, step: &Step) -> String {
        if step.in_main < VECTORS_END {
            return "interrupts".to_owned();
        }
        let called = step.called.and_then(|called| self.functions(called).pop());
        let inlined = || self.functions(step.in_main).into_iter().rev().nth(1);
        called.or_else(inlined).unwrap_or_else(|| "the loop itself".to_owned())
    }
}

/// Shortens a full name to `Type::function`: `<path::Type<..> as Trait>::function::<..>` or
/// `path::function`.
fn short(name: &str) -> String {
    let own = name.strip_prefix('<').and_then(|rest| {
        let mut depth = 1;
        let end = rest.find(|letter| {
            depth += i32::from(letter == '<') - i32::from(letter == '>');
            depth == 0
        })?;
        let of = rest[..end].split(" as ").next()?;
        Some(format!("{}{}", without_arguments(of), without_arguments(&rest[end + 1..])))
    });
    let plain = own.unwrap_or_else(|| without_arguments(name));
    let parts: Vec<&str> = plain.split("::").filter(|part| !part.is_empty()).collect();
    parts[parts.len().saturating_sub(2)..].join("::")
}

/// A path without generic arguments.
fn without_arguments(path: &str) -> String {
    let mut depth = 0;
    let mut outside = |letter: &char| {
        depth += i32::from(*letter == '<');
        let keep = depth == 0;
        depth -= i32::from(*letter == '>');
        keep
    };
    path.chars().filter(|letter| outside(letter)).collect()
}
