//! The stack of the whole program: the deepest path from the start, and the interrupt handlers that
//! can be on the stack above it at the same time.
//!
//! A handler that never enables interrupts can be on the stack once, on top. A handler that enables
//! them must have masked its own interrupt first, which is checked, so it can be on the stack once,
//! below another one. An interrupt pushes two bytes.

use std::rc::Rc;

use anyhow::{Context as _, Result, bail};
use serde::Serialize;

use crate::chip::{INTERRUPTS, vector};
use crate::opcode::Op;
use crate::program::Program;
use crate::stack::Analysis;
use crate::state::{Enables, Interrupts};
use crate::summary::{Depth, Entry, Kind, Summary};

/// Bytes that an interrupt or a call pushes.
const RETURN_ADDRESS: u32 = 2;

/// The part of the stack that a function takes, with the return address to its caller.
#[derive(Debug, Clone, Serialize)]
pub struct Frame {
    /// Name of the function.
    pub function: String,
    /// Bytes.
    pub bytes: u32,
}

/// A handler.
#[derive(Debug, Clone, Serialize)]
pub struct Handler {
    /// The interrupts, as the datasheet names them, with " and " between them.
    pub interrupt: String,
    /// Address of the first instruction.
    pub address: u32,
    /// Deepest stack, with the return address.
    pub bytes: u32,
    /// Deepest stack while another interrupt can come; `None` if none can.
    pub nested_bytes: Option<u32>,
    /// Its deepest path.
    pub frames: Vec<Frame>,
    #[serde(skip)]
    nested_frames: Vec<Frame>,
}

/// The stack of a program.
#[derive(Debug, Clone, Serialize)]
pub struct Stack {
    /// Deepest stack of the program with its interrupts, in bytes.
    pub bytes: u32,
    /// Its parts: they add up to `bytes`.
    pub frames: Vec<Frame>,
    /// First value of SP: the address of the last byte of the stack.
    pub base: u16,
    /// End of the variables, if the linker has defined it.
    pub variables_end: Option<u16>,
    /// The handlers; empty if interrupts are never enabled.
    pub handlers: Vec<Handler>,
}

/// Finds the deepest stack.
///
/// # Errors
/// If a path cannot be followed, or handlers can nest without limit; the text says where and why.
pub fn stack(analysis: &mut Analysis<'_>) -> Result<Stack> {
    let program = analysis.program;
    let reset = analysis.function(reset(program)).context("from the start of the program")?;
    let handlers = match reset.enabled {
        Some(_) => handlers(analysis)?,
        None => Vec::new(),
    };
    let base = match reset.base {
        Some(base) => base,
        None if reset.restarts => bail!(
            "the program jumps to its start, which does not set SP: the stack grows each time"
        ),
        None => program.chip.ram_end(),
    };
    let mut frames = frames(analysis, program.entry, reset.depth, 0);
    frames.extend(nested(&handlers));
    let bytes = frames.iter().map(|frame| frame.bytes).sum();
    let end = ["__heap_start", "_end", "__bss_end"].iter().find_map(|name| program.value(name));
    Ok(Stack { bytes, frames, base, variables_end: end.map(|end| end as u16), handlers })
}

/// How the program begins after a reset: interrupts and all their enable bits are 0.
pub fn reset(program: &Program) -> Entry {
    Entry {
        address: program.entry,
        kind: Kind::Reset,
        interrupts: Interrupts::Disabled,
        enables: Enables::default(),
    }
}

/// How a handler begins: its own interrupt is enabled, and interrupts are disabled.
pub fn handler(address: u32, interrupt: usize) -> Entry {
    let mut enables = Enables::default();
    let (register, bit) = INTERRUPTS[interrupt].enable;
    enables.set(register, bit, true);
    Entry { address, kind: Kind::Handler, interrupts: Interrupts::Disabled, enables }
}

/// The interrupts with a handler: an index of [`INTERRUPTS`], and the address to which the vector
/// jumps. A vector that leads to the start is of an interrupt that the program does not use. A
/// program that begins elsewhere than at 0 has no table of vectors.
pub fn vectors(program: &Program) -> Vec<(usize, u32)> {
    let target = |at| match program.instruction(at).ok()?.op {
        Op::Jmp(to) | Op::Rjmp(to) => Some(to),
        _ => None,
    };
    if program.entry != 0 {
        return Vec::new();
    }
    let start = target(0);
    let targets = (0..INTERRUPTS.len()).map_while(|index| Some((index, target(vector(index))?)));
    targets.filter(|(_, to)| *to != 0 && Some(*to) != start).collect()
}

/// Cycles from the beginning of the response to an interrupt to the first instruction of its
/// handler: four that push the program counter, and the jump of the vector.
pub fn vector_cycles(program: &Program, interrupt: usize) -> u32 {
    const RESPONSE: u32 = 4;
    RESPONSE + program.instruction(vector(interrupt)).map_or(0, |jump| jump.op.cycles())
}

fn handlers(analysis: &mut Analysis<'_>) -> Result<Vec<Handler>> {
    let program = analysis.program;
    let mut found: Vec<(Vec<usize>, Handler, Rc<Summary>)> = Vec::new();
    for (index, address) in vectors(program) {
        if let Some((interrupts, handler, _)) = found
            .iter_mut()
            .find(|(_, handler, _)| handler.address == address && handler.nested_bytes.is_none())
        {
            interrupts.push(index);
            if !handler.interrupt.ends_with("others") {
                handler.interrupt.push_str(" and others");
            }
            continue;
        }
        let name = INTERRUPTS[index].name;
        let summary = analysis
            .function(handler(address, index))
            .with_context(|| format!("in the handler of {name}"))?;
        if let Some((_, enables)) = &summary.enabled
            && !enables.is_masked(index)
        {
            bail!(
                "the handler of {name} at {address:#x} enables interrupts without masking its own: \
                 it can interrupt itself without limit, so clear its enable bit first"
            );
        }
        let handler = Handler {
            interrupt: name.into(),
            address,
            bytes: RETURN_ADDRESS + summary.depth.bytes,
            nested_bytes: summary.enabled.map(|(depth, _)| RETURN_ADDRESS + depth.bytes),
            frames: frames(analysis, address, summary.depth, RETURN_ADDRESS),
            nested_frames: match summary.enabled {
                Some((depth, _)) => frames(analysis, address, depth, RETURN_ADDRESS),
                None => Vec::new(),
            },
        };
        found.push((vec![index], handler, summary));
    }
    check_masks(&found)?;
    Ok(found.into_iter().map(|(_, handler, _)| handler).collect())
}

/// A handler that enables interrupts rests on its own being masked. So no other handler may unmask
/// it.
fn check_masks(found: &[(Vec<usize>, Handler, Rc<Summary>)]) -> Result<()> {
    for (interrupts, nesting, _) in
        found.iter().filter(|(_, handler, _)| handler.nested_bytes.is_some())
    {
        for (_, other, summary) in
            found.iter().filter(|(_, other, _)| other.address != nesting.address)
        {
            for interrupt in interrupts {
                let (register, bit) = INTERRUPTS[*interrupt].enable;
                let sets = Enables::index(register).map_or(0, |at| summary.sets[at]);
                if sets >> bit & 1 != 0 {
                    bail!(
                        "the handler of {} may enable {} while its handler is interrupted",
                        other.interrupt,
                        nesting.interrupt
                    );
                }
            }
        }
    }
    Ok(())
}

/// The deepest stack of handlers on top of each other.
fn nested(handlers: &[Handler]) -> Vec<Frame> {
    let (below, on_top): (Vec<&Handler>, Vec<&Handler>) =
        handlers.iter().partition(|handler| handler.nested_bytes.is_some());
    let deepest = on_top.iter().max_by_key(|handler| handler.bytes);
    // What a nesting handler takes in addition if it is the last.
    let rest = |handler: &Handler| handler.bytes - handler.nested_bytes.unwrap_or(0);
    let last = below.iter().copied().max_by_key(|handler| rest(handler));
    let is_last = |handler: &Handler| {
        let others = deepest.map_or(0, |deepest| deepest.bytes);
        last.is_some_and(|last| last.address == handler.address) && rest(handler) > others
    };
    let mut frames = Vec::new();
    let mut is_covered = false;
    for handler in below {
        let is_deepest = is_last(handler);
        is_covered |= is_deepest;
        let own = if is_deepest { &handler.frames } else { &handler.nested_frames };
        frames.extend(own.iter().cloned());
    }
    if let Some(deepest) = deepest.filter(|_| !is_covered) {
        frames.extend(deepest.frames.iter().cloned());
    }
    frames
}

/// The name of a function. avr-libc's names of handlers say nothing.
fn name(program: &Program, address: u32) -> String {
    let name = program.function_name(address);
    let number = name.strip_prefix("__vector_").and_then(|number| number.parse::<usize>().ok());
    match number.and_then(|number| INTERRUPTS.get(number.wrapping_sub(1))) {
        Some(interrupt) => interrupt.name.into(),
        None => name,
    }
}

/// The functions of a deepest path with their parts of the stack.
fn frames(analysis: &mut Analysis<'_>, address: u32, depth: Depth, pushed: u32) -> Vec<Frame> {
    let mut frames = Vec::new();
    let (mut address, mut depth, mut pushed) = (address, depth, pushed);
    loop {
        let name = name(analysis.program, address);
        let Some(callee) = depth.callee else {
            frames.push(Frame { function: name, bytes: pushed + depth.own });
            return frames;
        };
        // A tail call pushes nothing: then the height is 0.
        let return_address = depth.own.min(RETURN_ADDRESS);
        frames.push(Frame { function: name, bytes: pushed + depth.own - return_address });
        let Ok(summary) = analysis.function(callee) else { return frames };
        // Of a function that can be interrupted the deepest stack may be another one.
        let total = depth.bytes - depth.own;
        let next = match &summary.enabled {
            Some((enabled, _)) if summary.depth.bytes != total => *enabled,
            _ => summary.depth,
        };
        (address, depth, pushed) = (callee.address, next, return_address);
    }
}
