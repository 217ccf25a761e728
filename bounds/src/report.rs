//! What the command prints.

use std::fmt;

use serde::Serialize;

use crate::chip::RAM_START;
use crate::program::Program;
use crate::times::{HandlerTime, LoopBound, StretchTime, Times, TurnTime};
use crate::whole::{Frame, Stack};

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
}

impl Report {
    /// A report of a program.
    pub fn new(program: &Program, stack: Stack, times: Option<Times>) -> Self {
        // Variables above the stack do not count: then the linker's symbols say nothing about it.
        let end = stack.variables_end.filter(|end| *end <= stack.base);
        let variables = end.map(|end| u32::from(end.saturating_sub(RAM_START)));
        let ram_bytes = variables.map(|bytes| bytes + stack.bytes);
        Self { chip: program.chip.name(), stack, times, variables, ram_bytes }
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
            writeln!(f)?;
        }
        match &self.times {
            Some(times) => times.fmt(f),
            None => Ok(()),
        }
    }
}

impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for HandlerTime { interrupt, cycles } in &self.handlers {
            writeln!(f, "handler of {interrupt}: {cycles}")?;
        }
        for StretchTime { blocks, cycles, begins, ends } in &self.stretches {
            writeln!(f, "{blocks} blocked for {cycles}, {begins} to {ends}")?;
        }
        if let Some(TurnTime { place, cycles }) = &self.turn {
            writeln!(f, "turn of the main loop at {place}: {cycles}")?;
        }
        if f.alternate() {
            for LoopBound { place, number, rounds, cycles } in &self.loops {
                writeln!(f, "loop {number}: {rounds} rounds, {cycles} cycles, {place}")?;
            }
        }
        let turn = self.turn.as_ref().map(|turn| turn.cycles);
        if !self.is_bounded() || turn.is_some_and(|cycles| !cycles.is_bounded()) {
            for text in &self.missing {
                writeln!(f, "no bound: {text}")?;
            }
        }
        Ok(())
    }
}

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
