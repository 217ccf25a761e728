//! The stack of the whole program: the deepest path from the start, and the interrupt handlers that
//! can be on the stack above it at the same time.
//!
//! A handler that never enables interrupts can be on the stack once, on top. A handler that enables
//! them must have masked its own interrupt first, which is checked, so it can be on the stack once,
//! below another one. An interrupt pushes two bytes.
//!
//! What handlers change for the program below them depends on what others change for them, so it is
//! found in rounds, until nothing new is ([`settle`]).

use std::rc::Rc;

use anyhow::{Context as _, Result, bail};
use serde::Serialize;

use crate::chip::{INTERRUPTS, Interrupt, vector};
use crate::interference::Effect;
use crate::opcode::Op;
use crate::program::{Address, Program};
use crate::stack::Analysis;
use crate::state::{ENABLE_REGISTERS, Enables, Interrupts};
use crate::summary::{Depth, Summary, Vector, handler};

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
    /// True if the interrupt has no handler: its vector starts the program again.
    pub restarts: bool,
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
    settle(analysis)?;
    let program = analysis.program;
    let reset = analysis.function(analysis.reset)?;
    let handlers = handlers(analysis)?;
    let restarts = reset.restarts || handlers.iter().any(|handler| handler.restarts);
    let base = match reset.base {
        Some(_) if restarts && reset.before_base > 0 => bail!(
            "{}: the program jumps to its start, which uses the stack before it sets SP",
            Address(program.entry)
        ),
        Some(base) => base,
        None if restarts => bail!(
            "{}: the program jumps to its start, which does not set SP: the stack grows each time",
            Address(program.entry)
        ),
        None => program.chip.ram_end(),
    };
    let mut frames = frames(analysis, program.entry, reset.depth, 0);
    frames.extend(nested(&handlers));
    let bytes = frames.iter().map(|frame| frame.bytes).sum();
    check_stores(analysis, base, bytes)?;
    let end = ["__heap_start", "_end", "__bss_end"].iter().find_map(|name| program.value(name));
    Ok(Stack { bytes, frames, base, variables_end: end.map(|end| end as u16), handlers })
}

/// Finds which handlers can run, and what they change for what they interrupt.
///
/// # Errors
/// If a path cannot be followed, or an interrupt can happen that has no vector.
pub fn settle(analysis: &mut Analysis<'_>) -> Result<()> {
    while analysis.vectors.is_none() {
        analysis.forget();
        let program = analysis.program;
        let reset = analysis.function(analysis.reset).context("from the start of the program")?;
        let Some(enabled_at) = reset.enabled_at else {
            analysis.vectors = Some(Vec::new());
            return Ok(());
        };
        if program.entry != 0 {
            bail!(
                "{}: enables interrupts, and the program begins at {}: its table of vectors is not \
                 known",
                program.place(enabled_at),
                Address(program.entry)
            );
        }
        let found = reachable(analysis, &reset)?;
        let summaries = found.iter().map(|vector| analysis.function(vector.entry()));
        let summaries = summaries.collect::<Result<Vec<Rc<Summary>>>>()?;
        let restarts = |summary: &Rc<Summary>| summary.restarts_enabled;
        let mut has_changed = false;
        if analysis.reset.interrupts == Interrupts::Disabled
            && (reset.restarts_enabled || summaries.iter().any(restarts))
        {
            analysis.reset.interrupts = Interrupts::Either;
            has_changed = true;
        }
        for (vector, summary) in found.iter().zip(&summaries) {
            let effect = Effect::of(summary, vector.interrupt);
            has_changed |= analysis.interference.add(vector.interrupt, &effect);
        }
        if !has_changed {
            analysis.vectors = Some(found);
        }
    }
    Ok(())
}

/// The vectors of the interrupts that the program or a handler may enable.
fn reachable(analysis: &mut Analysis<'_>, reset: &Summary) -> Result<Vec<Vector>> {
    let mut sets = reset.sets;
    loop {
        let before = sets;
        let found = vectors(analysis.program, &sets)?;
        for vector in &found {
            let summary = analysis
                .function(vector.entry())
                .with_context(|| format!("in the handler of {}", vector.name()))?;
            for (mine, theirs) in sets.iter_mut().zip(summary.sets) {
                *mine |= theirs;
            }
        }
        if sets == before {
            return Ok(found);
        }
    }
}

/// A store to a fixed address may not be one to the stack.
fn check_stores(analysis: &Analysis<'_>, base: u16, bytes: u32) -> Result<()> {
    let lowest = (u32::from(base) + 1).saturating_sub(bytes) as u16;
    let mut stores = analysis.stores.range(lowest..);
    let Some((address, at)) = stores.next().filter(|(address, _)| **address <= base) else {
        return Ok(());
    };
    bail!(
        "{}: a store to {address:#x}, where the stack can be: from {lowest:#x} to {base:#x}",
        analysis.program.place(*at)
    )
}

/// The vectors that count. One with a jump to a handler counts always. One that leads to the start,
/// or that contains other code than a jump, counts if `sets` has the interrupt's enable bit.
fn vectors(program: &Program, sets: &[u8; ENABLE_REGISTERS.len()]) -> Result<Vec<Vector>> {
    const RESPONSE: u32 = 4;
    let start = program.start();
    let mut found = Vec::new();
    for (interrupt, Interrupt { name, enable: (register, bit) }) in INTERRUPTS.iter().enumerate() {
        let can_happen = Enables::index(*register).is_none_or(|at| sets[at] >> bit & 1 != 0);
        let slot = vector(interrupt);
        let first = program.instruction(slot).map(|first| first.op);
        let (address, jump, restarts) = match first {
            Ok(Op::Jmp(to) | Op::Rjmp(to)) if to == 0 || to == start => (slot, 0, true),
            Ok(op @ (Op::Jmp(to) | Op::Rjmp(to))) => (to, op.cycles(), false),
            Ok(_) => (slot, 0, false),
            Err(error) if can_happen => {
                bail!("the vector of {name}, which the program may enable: {error:#}")
            }
            Err(_) => continue,
        };
        if can_happen || address != slot {
            found.push(Vector { interrupt, address, cycles: RESPONSE + jump, restarts });
        }
    }
    Ok(found)
}

fn handlers(analysis: &mut Analysis<'_>) -> Result<Vec<Handler>> {
    let mut found: Vec<(Vec<usize>, Handler, Rc<Summary>)> = Vec::new();
    for vector in analysis.vectors.clone().unwrap_or_default() {
        let Vector { interrupt: index, address, restarts, .. } = vector;
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
        let handler = Handler {
            interrupt: name.into(),
            address,
            bytes: RETURN_ADDRESS + summary.depth.bytes,
            restarts,
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
    for (interrupts, Handler { interrupt: name, address, .. }, summary) in &found {
        let Some((_, enables)) = &summary.enabled else { continue };
        if !interrupts.iter().all(|index| enables.is_masked(*index)) {
            bail!(
                "the handler of {name} at {address:#x} enables interrupts without masking its own: \
                 it can interrupt itself without limit, so clear its enable bit first"
            );
        }
    }
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
                        "the handler of {} at {:#x} may enable {} while its handler is interrupted",
                        other.interrupt,
                        other.address,
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
    if let Some(index) = (0..INTERRUPTS.len()).find(|index| vector(*index) == address) {
        return INTERRUPTS[index].name.into();
    }
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
