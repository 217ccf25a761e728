//! What the command prints.

use std::fmt;

use anyhow::Result;
use serde::Serialize;

use crate::annotations::Annotations;
use crate::assumptions::{Assumption, assumptions};
use crate::chip::{Chip, RAM_START};
use crate::program::Program;
use crate::stack::Analysis;
use crate::times::{
    BitTime, HandlerTime, KindTime, LookTime, LoopBound, OpenLoop, StretchTime, ThroughTime, Times,
    TurnTime, handler_times, times,
};
use crate::whole::{self, Frame, Stack};

/// What is to be found of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scope {
    /// The stack.
    Stack,
    /// The stack, and the times of the interrupt handlers.
    Handlers,
    /// The stack, and all times.
    Everything,
}

/// All that was found.
#[derive(Debug, Serialize)]
pub struct Report {
    /// The chip.
    pub chip: &'static str,
    /// The stack.
    pub stack: Stack,
    /// The times, if they were asked for.
    pub times: Option<Times>,
    /// Bytes of the variables, if the linker has defined their end.
    pub variables: Option<u32>,
    /// Bytes of variables and stack.
    pub ram_bytes: Option<u32>,
    /// What must be true, or the figures are not.
    pub assumptions: Vec<Assumption>,
    /// The entries of the annotations that say nothing about this program: they may be for another
    /// one, or have the former name of a function. Found with all times only.
    pub unused: Vec<String>,
}

impl Report {
    /// Analyses a program.
    ///
    /// # Errors
    /// If it cannot be followed.
    pub fn of(elf: &[u8], chip: Chip, mut annotations: Annotations, scope: Scope) -> Result<Self> {
        let program = Program::from_elf(elf, chip)?;
        let all = annotations.clone();
        annotations.keep_those_of(&program);
        let mut analysis = Analysis::new(&program, &annotations);
        let stack = whole::stack(&mut analysis)?;
        let times = match scope {
            Scope::Stack => None,
            Scope::Handlers => Some(handler_times(&mut analysis)?),
            Scope::Everything => Some(times(&mut analysis)?),
        };
        let unused = match &times {
            Some(times) if scope == Scope::Everything => all.unused(&program, &times.used),
            _ => vec![],
        };
        let annotated = times.iter().flat_map(|times| &times.annotated);
        let assumptions = assumptions(&analysis, annotated);
        Ok(Self::new(&program, stack, times, assumptions, unused))
    }

    fn new(
        program: &Program,
        stack: Stack,
        times: Option<Times>,
        assumptions: Vec<Assumption>,
        unused: Vec<String>,
    ) -> Self {
        // Variables above the stack do not count: then the linker's symbols say nothing about it.
        let end = stack.variables_end.filter(|end| *end <= stack.base);
        let variables = end.map(|end| u32::from(end.saturating_sub(RAM_START)));
        let ram_bytes = variables.map(|bytes| bytes + stack.bytes);
        Self { chip: program.chip.name(), stack, times, variables, ram_bytes, assumptions, unused }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let stack = &self.stack;
        writeln!(f, "stack at its deepest: {} bytes", stack.bytes)?;
        writeln!(f, "  = {}", Sum(&stack.frames))?;
        if let (Some(variables), Some(ram)) = (self.variables, self.ram_bytes) {
            let below = u32::from(stack.base) + 1 - u32::from(RAM_START);
            writeln!(f, "variables {variables} bytes, with the stack {ram} of {below}")?;
        }
        for handler in &stack.handlers {
            write!(f, "handler of {}: {} bytes", handler.interrupt, handler.bytes)?;
            if let Some(nested) = handler.nested_bytes {
                write!(f, ", {nested} while another interrupt can come")?;
            }
            if handler.restarts {
                write!(f, ", has no handler: its vector starts the program again")?;
            }
            writeln!(f)?;
        }
        if let Some(times) = &self.times {
            times.fmt(f)?;
        }
        for Assumption { text, places } in &self.assumptions {
            let shown = if f.alternate() { places.len() } else { 1 };
            write!(f, "assumed: {text}: {}", places[..shown].join(", "))?;
            match places.len() - shown {
                0 => writeln!(f)?,
                more => writeln!(f, " and {more} more")?,
            }
        }
        if !self.unused.is_empty() {
            writeln!(f, "annotations that say nothing about it: {}", self.unused.join(", "))?;
        }
        Ok(())
    }
}

impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for HandlerTime { interrupt, cycles, bits, looks } in &self.handlers {
            writeln!(f, "handler of {interrupt}: {cycles}")?;
            if f.alternate() {
                write_bits(f, bits)?;
                write_looks(f, looks)?;
            }
        }
        for (n, StretchTime { blocks, cycles, begins, ends, .. }) in
            self.stretches.iter().enumerate()
        {
            let of_same = self.stretches[..n].iter().filter(|other| other.blocks == *blocks);
            if of_same.count() < LISTED || f.alternate() {
                writeln!(f, "{blocks} blocked for {cycles}, {begins} to {ends}")?;
            }
        }
        for name in &self.partly_enabled {
            writeln!(f, "{name} is enabled on some paths only")?;
        }
        if let Some(TurnTime { place, cycles, through, of_kinds, .. }) = &self.turn {
            writeln!(f, "turn of the main loop at {place}: {cycles}")?;
            for KindTime { names, cycles, .. } in of_kinds {
                let names = if names.is_empty() { "of no kind".into() } else { names.join(" + ") };
                writeln!(f, "  {names}: {cycles}")?;
            }
            let shown = if f.alternate() { through.len() } else { 0 };
            for ThroughTime { function, cycles, .. } in &through[..shown] {
                writeln!(f, "  with a call of {function}: {cycles}")?;
            }
        }
        if let Some(cycles) = &self.start {
            writeln!(f, "from the reset to the jump to 0: {cycles}")?;
        }
        for OpenLoop { place, number, cycles, until, .. } in &self.open {
            writeln!(f, "not counted: {place}, loop {number}, rounds of {cycles}, until {until}")?;
        }
        if f.alternate() {
            for LoopBound { place, number, begins, rounds, cycles } in &self.loops {
                writeln!(f, "loop {number}: {rounds} rounds, {cycles} cycles, {place}: {begins}")?;
            }
        }
        for text in &self.missing {
            writeln!(f, "no bound: {text}")?;
        }
        Ok(())
    }
}

fn write_bits(f: &mut fmt::Formatter<'_>, bits: &[BitTime]) -> fmt::Result {
    for BitTime { register, bit, is_set, cycles, .. } in bits {
        let what = if *is_set { "sets" } else { "clears" };
        writeln!(f, "  {what} bit {bit} of {register:#04x} after {cycles} at most")?;
    }
    Ok(())
}

fn write_looks(f: &mut fmt::Formatter<'_>, looks: &[LookTime]) -> fmt::Result {
    for LookTime { register, cycles, .. } in looks {
        writeln!(f, "  looks at {register:#04x} {cycles} at most before its end")?;
    }
    Ok(())
}

/// Stretches that are printed for each interrupt; `--loops` prints all.
const LISTED: usize = 4;

/// Frames as a sum.
struct Sum<'a>(&'a [Frame]);

impl fmt::Display for Sum<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (n, frame) in self.0.iter().filter(|frame| frame.bytes > 0).enumerate() {
            let plus = if n == 0 { "" } else { " + " };
            write!(f, "{plus}{} {}", frame.function, frame.bytes)?;
        }
        Ok(())
    }
}
