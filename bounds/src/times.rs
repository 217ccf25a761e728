//! The times of the whole program: each interrupt handler, each stretch with interrupts blocked, a
//! turn of the main loop.

use anyhow::{Context as _, Result};
use serde::Serialize;

use crate::chip::INTERRUPTS;
use crate::clock::Watch;
use crate::cycles::Timing;
use crate::endless::{self, Endless};
use crate::stack::Analysis;
use crate::whole::{handler, reset, vector_cycles, vectors};

/// The time of an interrupt handler.
#[derive(Debug, Clone, Serialize)]
pub struct HandlerTime {
    /// The interrupt, as the datasheet names it.
    pub interrupt: &'static str,
    /// Cycles from the interrupt's response to the end of RETI, without those of handlers that
    /// interrupt it. `None` if the handler never returns.
    pub cycles: Option<u32>,
}

/// A stretch with an interrupt blocked.
#[derive(Debug, Clone, Serialize)]
pub struct StretchTime {
    /// The interrupt, or "interrupts" for all.
    pub blocks: &'static str,
    /// Cycles at most, without those of handlers that interrupt it.
    pub cycles: u32,
    /// Where it begins.
    pub begins: String,
    /// Where it ends.
    pub ends: String,
}

/// The main loop: the largest loop of the functions that do not return.
#[derive(Debug, Clone, Serialize)]
pub struct TurnTime {
    /// Its first instruction.
    pub place: String,
    /// Cycles of its longest round, without those of handlers.
    pub cycles: u32,
}

/// A loop with a bound.
#[derive(Debug, Clone, Serialize)]
pub struct LoopBound {
    /// Its first instruction.
    pub place: String,
    /// Its number in the function, by which an annotation can name it.
    pub number: usize,
    /// How often it goes back to its beginning, at most, each time it is reached.
    pub rounds: u32,
    /// Cycles of these rounds.
    pub cycles: u32,
}

/// The times of a program.
#[derive(Debug, Clone, Serialize)]
pub struct Times {
    /// The handlers that a vector leads to.
    pub handlers: Vec<HandlerTime>,
    /// The longest stretches, those of each interrupt together.
    pub stretches: Vec<StretchTime>,
    /// The main loop.
    pub turn: Option<TurnTime>,
    /// The loops with a bound, the longest first.
    pub loops: Vec<LoopBound>,
    /// Loops without a bound. If there are any, the other figures are no bounds.
    pub missing: Vec<String>,
}

/// Stretches that are listed for each interrupt.
const LISTED: usize = 4;

/// Finds the longest times.
///
/// # Errors
/// If a path cannot be followed.
pub fn times(analysis: &mut Analysis<'_>) -> Result<Times> {
    let program = analysis.program;
    let reset = reset(program);
    let has_interrupts = analysis.function(reset)?.enabled.is_some();
    let vectors = if has_interrupts { vectors(program) } else { Vec::new() };
    let mut watches = vec![Watch::All];
    for (interrupt, address) in &vectors {
        let nests = analysis.function(handler(*address, *interrupt))?.enabled.is_some();
        // A handler that several vectors share belongs to none of them.
        let is_own = vectors.iter().filter(|(_, other)| other == address).count() == 1;
        if nests && is_own {
            watches.push(Watch::One(*interrupt));
        }
    }
    let mut timing = Timing::new(analysis, watches.clone());
    let turn = match endless::main_loop(&mut timing, reset)? {
        Some(Endless { entry, inner, state }) => {
            let cycles = timing.turn(entry, &inner, state).context("in the main loop")?;
            Some(TurnTime { place: program.place(inner.head), cycles })
        }
        None => None,
    };
    let mut handlers = Vec::new();
    for (interrupt, address) in vectors {
        let name = INTERRUPTS[interrupt].name;
        let time = timing
            .function(handler(address, interrupt))
            .with_context(|| format!("in the handler of {name}"))?;
        let before = vector_cycles(program, interrupt);
        for (watch, ended) in time.ended.iter().enumerate() {
            if let Some((cycles, end)) = ended {
                timing.ended.note(watch, address, *end, before + cycles);
            }
        }
        let cycles = time.exit.as_ref().map(|(_, clocks)| before + clocks.total);
        handlers.push(HandlerTime { interrupt: name, cycles });
    }
    let all = timing.ended.list(&watches);
    let of = |watch: &Watch| {
        let name = watch.name();
        all.iter().filter(move |stretch| stretch.blocks == name).take(LISTED)
    };
    let stretches = watches.iter().flat_map(of).map(|stretch| StretchTime {
        blocks: stretch.blocks,
        cycles: stretch.cycles,
        begins: program.place(stretch.begins),
        ends: program.place(stretch.ends),
    });
    let loops = timing.bounds.iter().map(|(head, bound)| LoopBound {
        place: program.place(*head),
        number: bound.number,
        rounds: bound.rounds,
        cycles: bound.cycles,
    });
    let mut loops: Vec<LoopBound> = loops.collect();
    loops.sort_by_key(|found| std::cmp::Reverse(found.cycles));
    Ok(Times {
        loops,
        handlers,
        stretches: stretches.collect(),
        turn,
        missing: timing.missing.iter().cloned().collect(),
    })
}
