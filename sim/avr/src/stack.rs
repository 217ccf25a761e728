//! The stack: how deep it has been, and when it runs into variables or the heap.
//!
//! An engine tells each time at which the stack pointer is below the mark. The own engine does so
//! without a cost above the mark; simavr runs instruction by instruction for it, and only if
//! somebody asks. After each run [`Stack::settle`] compares with the end of the variables and of
//! the heap, which avr-libc has in `__brkval`.

use std::cell::{Cell, RefCell};
use std::ops::Range;

use super::base::Base;
use super::elf::{Firmware, Names};
use super::processor::Violation;
use super::regs;
use sim_base::Cycles;

/// avr-libc's variable with the end of the heap, 0 before the first allocation.
const HEAP_END: &str = "__brkval";
/// Most names of variables in a text.
const NAMES_MAX: usize = 3;

/// What a program has in its memory.
struct Map {
    functions: Names,
    variables: Names,
    /// First address behind the variables.
    end: u16,
    /// Address of the variable [`HEAP_END`].
    heap_end: Option<u16>,
}

/// A stack pointer, and where the program was.
#[derive(Debug, Clone, Copy)]
struct Depth {
    at: Cycles,
    sp: u16,
    pc: u32,
}

/// The stack of a program.
#[derive(Default)]
pub(super) struct Stack {
    map: RefCell<Option<Map>>,
    deepest: Cell<Option<Depth>>,
    /// The deepest one below the mark since the last `settle`.
    lowered: Cell<Option<Depth>>,
    /// The deepest one in variables that has not been reported, and the end of what is below it.
    overrun: Cell<Option<(Depth, u16)>>,
    has_overrun: Cell<bool>,
    /// When it passed the end of the variables: what goes wrong then is its consequence.
    passed_at: Cell<Option<Cycles>>,
    /// True if the program has put the stack elsewhere, as an operating system does.
    has_several: Cell<bool>,
}

impl Stack {
    /// Sets the program; `None` if it is not known, or can be replaced.
    pub fn set_program(&self, firmware: Option<&Firmware>) {
        self.map.replace(firmware.filter(|firmware| firmware.has_statics).map(|firmware| Map {
            functions: firmware.functions.clone(),
            variables: firmware.variables.clone(),
            end: regs::RAMSTART.saturating_add(firmware.statics as u16),
            heap_end: firmware.symbols.get(HEAP_END).map(|symbol| symbol.address as u16),
        }));
    }

    /// Notes a stack pointer below the mark.
    pub fn lower(&self, at: Cycles, sp: u16, pc: u32, is_set_by_hand: bool) {
        let bottom = self.map.borrow().as_ref().map_or(0, |map| map.end);
        if is_set_by_hand && sp < bottom {
            self.has_several.set(true);
        }
        if sp + 1 < bottom && self.passed_at.get().is_none() {
            self.passed_at.set(Some(at));
        }
        let depth = Depth { at, sp, pc };
        for lowest in [&self.deepest, &self.lowered] {
            if lowest.get().is_none_or(|lowest| sp < lowest.sp) {
                lowest.set(Some(depth));
            }
        }
    }

    /// The lowest stack pointer, or `None` if the program has several stacks.
    pub fn lowest(&self) -> Option<u16> {
        self.deepest.get().map(|depth| depth.sp).filter(|_| !self.has_several.get())
    }

    /// True if the stack has run into variables.
    pub fn has_overrun(&self) -> bool {
        self.has_overrun.get()
    }

    /// Compares the stack with the variables after a run. Returns the next mark in place of `mark`.
    pub fn settle(&self, base: &Base, mark: u16) -> u16 {
        let map = self.map.borrow();
        let Some(map) = map.as_ref().filter(|_| !self.has_several.get()) else { return mark };
        let end = map.end.max(map.heap_end(base));
        if let Some(depth) = self.lowered.take().filter(|depth| depth.sp < end - 1) {
            let known = self.overrun.get();
            if known.is_none_or(|(known, _)| depth.sp < known.sp) {
                self.overrun.set(Some((depth, end)));
                self.has_overrun.set(true);
            }
        }
        // The heap can have grown to where the stack has been. While the stack is in variables,
        // only what is deeper is new.
        if base.sp() < end - 1 { mark } else { mark.max(end - 1) }
    }

    /// Removes and returns the mistake of a stack that has run into variables.
    pub fn take_overrun(&self, base: &Base) -> Option<Violation> {
        let (depth, end) = self.overrun.take()?;
        let map = self.map.borrow();
        let map = map.as_ref()?;
        let ram_end = base.core.chip().ram_end();
        let within = map.functions.at(depth.pc).map_or(String::new(), |name| format!(" in {name}"));
        let text = format!(
            "the stack runs into {}: it is {} bytes deep{within}, and {} are free (PC {:#06x})",
            map.names(depth.sp + 1..end),
            ram_end - depth.sp,
            (ram_end + 1).saturating_sub(end),
            depth.pc,
        );
        Some(Violation { at: self.passed_at.take().unwrap_or(depth.at), text })
    }
}

impl Map {
    /// The end of the heap, 0 if there is none.
    fn heap_end(&self, base: &Base) -> u16 {
        let ram_end = base.core.chip().ram_end();
        let Some(low) = self.heap_end.filter(|low| *low < ram_end) else { return 0 };
        let end = u16::from_le_bytes([base.core.get(low), base.core.get(low + 1)]);
        if end <= ram_end { end } else { 0 }
    }

    /// What is in a range of the RAM, the largest first.
    fn names(&self, range: Range<u16>) -> String {
        let heap = (range.end > self.end).then_some("the heap");
        let variables = self.variables.within(range.start.into()..range.end.min(self.end).into());
        let registers = (range.start < regs::RAMSTART).then_some("the registers");
        let all: Vec<&str> = heap.into_iter().chain(registers).chain(variables).collect();
        match all.len() {
            0 => format!("the variables at {:#06x}", range.end.min(self.end) - 1),
            1..=NAMES_MAX => all.join(", "),
            count => format!("{} and {} more", all[..NAMES_MAX].join(", "), count - NAMES_MAX),
        }
    }
}
