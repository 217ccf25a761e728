//! The times of the whole program: each interrupt handler, each stretch with interrupts blocked, a
//! turn of the main loop.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use anyhow::{Context as _, Result};
use serde::Serialize;

use crate::clock::{Clocks, Kinds, Watch};
use crate::cycles::Timing;
use crate::opcode::Op;
use crate::path::{Time, Told, Turn};
use crate::program::Program;
use crate::stack::Analysis;
use crate::text::Text;
use crate::whole::settle;

/// A number of cycles, or none if a loop has no bound: then `null` in JSON.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(into = "Option<u32>")]
pub struct Cycles(pub u32);

impl Cycles {
    /// True if there is a bound.
    pub fn is_bounded(self) -> bool {
        self.0 != u32::MAX
    }
}

impl From<Cycles> for Option<u32> {
    fn from(cycles: Cycles) -> Self {
        cycles.is_bounded().then_some(cycles.0)
    }
}

impl fmt::Display for Cycles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.is_bounded() {
            true => write!(f, "{} cycles", self.0),
            false => f.write_str("no bound"),
        }
    }
}

/// The time of an interrupt handler that returns.
#[derive(Debug, Clone, Serialize)]
pub struct HandlerTime {
    /// The interrupt, as the datasheet names it.
    pub interrupt: &'static str,
    /// Cycles from the interrupt's response to the end of RETI, without those of handlers that
    /// interrupt it.
    pub cycles: Cycles,
    /// The bits of I/O registers that it sets and clears.
    pub bits: Vec<BitTime>,
    /// The pins at which it looks.
    pub looks: Vec<LookTime>,
}

/// The time from the last look at a pin, after which the SPI is not used, to the end of a handler.
#[derive(Debug, Clone, Serialize)]
pub struct LookTime {
    /// The address of the instruction: IN, SBIC or SBIS.
    pub at: u32,
    /// PINB, PINC or PIND, in the data space.
    pub register: u16,
    /// Cycles from the end of the look to the end of RETI.
    pub cycles: Cycles,
}

/// The time of an SBI or CBI in a handler.
#[derive(Debug, Clone, Serialize)]
pub struct BitTime {
    /// Its address.
    pub at: u32,
    /// The register, in the data space, and the bit.
    pub register: u16,
    /// See `register`.
    pub bit: u8,
    /// True if it sets the bit.
    pub is_set: bool,
    /// Cycles from the interrupt's response to the end of the instruction, the last time that the
    /// handler gets there.
    pub cycles: Cycles,
}

/// A stretch with an interrupt blocked.
#[derive(Debug, Clone, Serialize)]
pub struct StretchTime {
    /// The interrupt, or "interrupts" for all.
    pub blocks: &'static str,
    /// Cycles at most, without those of handlers that interrupt it.
    pub cycles: Cycles,
    /// Where it begins.
    pub begins: String,
    /// Where it ends.
    pub ends: String,
    /// Address of the instruction that begins it: of a handler the first one.
    pub from: u32,
    /// Address of the instruction that ends it.
    pub to: u32,
}

/// The main loop: the largest loop of the functions that do not return.
#[derive(Debug, Clone, Serialize)]
pub struct TurnTime {
    /// Its first instruction.
    pub place: String,
    /// Address of that.
    pub head: u32,
    /// Cycles of its longest round, without those of handlers. A program that sleeps has no bound.
    pub cycles: Cycles,
    /// The rounds in which a function is called, the longest first.
    pub through: Vec<ThroughTime>,
    /// The rounds of each combination of kinds that the annotations name, the longest first.
    pub of_kinds: Vec<KindTime>,
    /// The functions of which a call tells the kind of a round, by their addresses.
    #[serde(skip)]
    pub kinds: BTreeMap<u32, Kinds>,
}

/// The rounds of the main loop of certain kinds, and of no others.
#[derive(Debug, Clone, Serialize)]
pub struct KindTime {
    /// The names of the kinds, from the annotations. None: the rounds of no kind.
    pub names: Vec<String>,
    /// Their numbers.
    #[serde(skip)]
    pub kinds: Kinds,
    /// Cycles of the longest of these rounds, without those of handlers.
    pub cycles: Cycles,
}

/// The rounds of the main loop in which a function is called.
#[derive(Debug, Clone, Serialize)]
pub struct ThroughTime {
    /// The function.
    pub function: String,
    /// Its first instruction.
    pub address: u32,
    /// Cycles of the longest of these rounds, without those of handlers.
    pub cycles: Cycles,
}

/// A loop with a bound.
#[derive(Debug, Clone, Serialize)]
pub struct LoopBound {
    /// Its first instruction.
    pub place: String,
    /// Its number in the function, by which an annotation can name it.
    pub number: usize,
    /// The text of its first instruction.
    pub begins: String,
    /// How often it goes back to its beginning, at most, each time it is reached.
    pub rounds: u32,
    /// Cycles of these rounds.
    pub cycles: u32,
}

/// A loop whose rounds are not counted, because something outside of the chip ends it.
#[derive(Debug, Clone, Serialize)]
pub struct OpenLoop {
    /// Its first instruction.
    pub place: String,
    /// Its number in the function, by which an annotation can name it.
    pub number: usize,
    /// Cycles of its longest round.
    pub cycles: Cycles,
    /// What ends it.
    pub until: String,
    /// Why its time has a bound, or need not have one.
    pub reason: String,
}

/// The times of a program.
#[derive(Debug, Clone, Serialize)]
pub struct Times {
    /// Address of the program's first instruction.
    pub entry: u32,
    /// The handlers that a vector leads to.
    pub handlers: Vec<HandlerTime>,
    /// The longest stretches, those of each interrupt together.
    pub stretches: Vec<StretchTime>,
    /// The main loop.
    pub turn: Option<TurnTime>,
    /// Of a program that begins elsewhere: the longest time from the reset to its jump to 0, where
    /// another program begins.
    pub start: Option<Cycles>,
    /// The loops whose rounds are not counted.
    pub open: Vec<OpenLoop>,
    /// The loops with a bound, the longest first.
    pub loops: Vec<LoopBound>,
    /// Interrupts that mask themselves while their handlers run, and that the main program enables
    /// on some paths only. Of the main program's stretches those of all interrupts count for them.
    pub partly_enabled: Vec<&'static str>,
    /// Loops without a bound.
    pub missing: Vec<String>,
    /// The loops of which an annotation tells the number of rounds, by the address of the first
    /// instruction.
    #[serde(skip)]
    pub told: BTreeMap<u32, Told>,
    /// What the annotations say that were used, by the first instruction of the loop.
    #[serde(skip)]
    pub annotated: BTreeMap<u32, String>,
    /// The names of the annotations that were used.
    #[serde(skip)]
    pub used: BTreeSet<String>,
}

impl Times {
    /// True if each loop has a bound, or an annotation that says what ends it.
    pub fn is_explained(&self) -> bool {
        let open = self.open.iter().all(|found| found.cycles.is_bounded());
        open && self.missing.is_empty() && self.start.is_none_or(Cycles::is_bounded)
    }

    /// True if each handler and each stretch has a bound. A turn of the main loop may wait.
    pub fn is_bounded(&self) -> bool {
        let stretches = self.stretches.iter().map(|stretch| stretch.cycles);
        let handlers = self.handlers.iter().map(|handler| handler.cycles);
        stretches.chain(handlers).all(Cycles::is_bounded)
    }
}

/// Finds the longest times.
///
/// # Errors
/// If a path cannot be followed.
pub fn times(analysis: &mut Analysis<'_>) -> Result<Times> {
    times_of(analysis, true)
}

/// Finds the longest times of the handlers only, which takes less time.
///
/// # Errors
/// If a path cannot be followed.
pub fn handler_times(analysis: &mut Analysis<'_>) -> Result<Times> {
    times_of(analysis, false)
}

fn times_of(analysis: &mut Analysis<'_>, has_main: bool) -> Result<Times> {
    settle(analysis)?;
    let program = analysis.program;
    let reset = analysis.reset;
    let vectors = analysis.vectors.clone().unwrap_or_default();
    let mut watches = vec![Watch::All];
    for vector in &vectors {
        let nests = analysis.function(vector.entry())?.enabled.is_some();
        // A handler that several vectors share belongs to none of them.
        let is_own = vectors.iter().filter(|other| other.address == vector.address).count() == 1;
        if nests && is_own {
            watches.push(Watch::One(vector.interrupt));
        }
    }
    let mut timing = Timing::new(analysis, watches.clone());
    // What is blocked from the reset to the first time that interrupts are enabled is no stretch.
    let main = has_main.then(|| timing.function(reset)).transpose();
    let main = main.context("from the start of the program")?;
    let start = main.and_then(|time| time.restart.filter(|_| program.entry != 0)).map(Cycles);
    let turn = timing.turn.take();
    let is_enabled = |watch: &&Watch| turn.is_none_or(|turn| watch.is_enabled(&turn.enables));
    let partly = watches.iter().filter(|watch| !is_enabled(watch)).map(|watch| watch.name());
    let partly_enabled = partly.collect();
    let turn = turn.map(|Turn { head, cycles, is_open, .. }| {
        let bound = |cycles: u32| Cycles(if is_open { u32::MAX } else { cycles });
        let through = timing.through.get(&head).into_iter().flatten();
        let through = through.map(|(address, cycles)| ThroughTime {
            function: program.function_name(*address),
            address: *address,
            cycles: bound(*cycles),
        });
        let mut through: Vec<ThroughTime> = through.collect();
        through.sort_by_key(|found| std::cmp::Reverse(found.cycles));
        let of_kinds = timing.of_kinds.get(&head).into_iter().flatten();
        let of_kinds = of_kinds.map(|(kinds, cycles)| KindTime {
            names: timing.analysis.annotations.names_of(*kinds),
            kinds: *kinds,
            cycles: bound(*cycles),
        });
        let mut of_kinds: Vec<KindTime> = of_kinds.collect();
        of_kinds.sort_by_key(|found| std::cmp::Reverse(found.cycles));
        let kinds = timing.kinds.clone();
        let (place, cycles) = (program.place(head), bound(cycles));
        TurnTime { place, head, cycles, through, of_kinds, kinds }
    });
    let mut handlers = Vec::new();
    for vector in vectors {
        let (name, address, before) = (vector.name(), vector.address, vector.cycles);
        let time =
            timing.function(vector.entry()).with_context(|| format!("in the handler of {name}"))?;
        for (watch, ended) in time.ended.iter().enumerate() {
            if let Some((cycles, end)) = ended {
                timing.ended.note(watch, address, *end, before.saturating_add(*cycles));
            }
        }
        if let Some((_, clocks)) = &time.exit {
            if clocks.opens > 0 {
                let text = format!("the handler of {name} contains a loop that is not counted");
                timing.missing.insert(text);
            }
            let cycles = Cycles(before.saturating_add(clocks.bounded_total()));
            let (bits, looks) = (bits(program, &time, before), looks(program, clocks));
            handlers.push(HandlerTime { interrupt: name, cycles, bits, looks });
        }
    }
    let all = timing.ended.list(&watches);
    let of = |watch: &Watch| {
        let name = watch.name();
        all.iter().filter(move |stretch| stretch.blocks == name)
    };
    let stretches = watches.iter().flat_map(of).map(|stretch| StretchTime {
        blocks: stretch.blocks,
        cycles: Cycles(stretch.cycles),
        begins: program.place(stretch.begins),
        ends: program.place(stretch.ends),
        from: stretch.begins,
        to: stretch.ends,
    });
    let loops = timing.bounds.iter().map(|(head, bound)| LoopBound {
        place: program.place(*head),
        number: bound.number,
        begins: program
            .instruction(*head)
            .map_or(String::new(), |first| Text(first.op, *head).to_string()),
        rounds: bound.rounds,
        cycles: bound.cycles,
    });
    let mut loops: Vec<LoopBound> = loops.collect();
    loops.sort_by_key(|found| std::cmp::Reverse(found.cycles));
    let open = timing.opens.iter().map(|(head, open)| OpenLoop {
        place: program.place(*head),
        number: open.number,
        cycles: Cycles(open.cycles),
        until: open.until.clone(),
        reason: open.reason.clone(),
    });
    Ok(Times {
        entry: program.entry,
        open: open.collect(),
        start,
        loops,
        handlers,
        stretches: stretches.collect(),
        turn,
        partly_enabled,
        missing: timing.missing.iter().cloned().collect(),
        told: std::mem::take(&mut timing.told),
        annotated: std::mem::take(&mut timing.annotated),
        used: std::mem::take(&mut timing.used),
    })
}

/// The bits that a handler sets and clears. It begins `before` cycles after the response.
fn bits(program: &Program, time: &Time, before: u32) -> Vec<BitTime> {
    let found = time.bits.iter().filter_map(|(at, cycles)| {
        let (io, bit, is_set) = match program.instruction(*at).ok()?.op {
            Op::Sbi(io, bit) => (io, bit, true),
            Op::Cbi(io, bit) => (io, bit, false),
            _ => return None,
        };
        let cycles = Cycles(before.saturating_add(*cycles));
        Some(BitTime { at: *at, register: u16::from(io) + 0x20, bit, is_set, cycles })
    });
    found.collect()
}

/// The last looks of a handler at pins.
fn looks(program: &Program, clocks: &Clocks) -> Vec<LookTime> {
    let found = clocks.looked.own.iter().filter_map(|(at, cycles)| {
        let (Op::In(_, io) | Op::Sbis(io, _) | Op::Sbic(io, _)) = program.instruction(*at).ok()?.op
        else {
            return None;
        };
        Some(LookTime { at: *at, register: u16::from(io) + 0x20, cycles: Cycles(*cycles) })
    });
    found.collect()
}
