//! The part of the run loop that looks after a debugger: stops the chip before an instruction, lets it go on or make one
//! step.
//!
//! Breakpoints are kept beside the flash, not in it, so there may be any number and the program sees none. Only while one
//! is set, or a step is made, does the core run instruction by instruction; otherwise the run loop tests one flag. A
//! chip that is halted lets no time pass: its clock, and what is clocked by it, stands still.

use std::cell::{Cell, RefCell};
use std::collections::HashSet;

use super::core::{Activity, Core};

/// Why the chip is halted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Halt {
    /// The debugger asked for it.
    Asked,
    /// A breakpoint is on the next instruction.
    Breakpoint,
    /// The step is made.
    Stepped,
    /// The program ran off the flash that can be read.
    Crashed,
}

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Debug {
    breakpoints: RefCell<HashSet<u32>>,
    halted: Cell<Option<Halt>>,
    stepping: Cell<bool>,
    /// The next instruction was seen already: it runs, breakpoint or not.
    passed: Cell<bool>,
    /// There is something to look for before each instruction.
    watching: Cell<bool>,
}

impl Debug {
    /// Whether [`Debug::halts`] must be asked before each instruction.
    #[inline]
    pub fn is_watching(&self) -> bool {
        self.watching.get()
    }

    /// Whether the chip is halted.
    pub fn is_halted(&self) -> bool {
        self.halted.get().is_some()
    }

    /// Decides before an instruction whether the chip halts there. If not, lets the core run that instruction only.
    pub fn halts(&self, core: &Core) -> bool {
        if self.halted.get().is_some() {
            return true;
        }
        if core.activity() != Activity::Running {
            return false;
        }
        if !self.passed.replace(false) {
            if self.stepping.get() {
                self.halt(Halt::Stepped);
                return true;
            }
            if self.breakpoints.borrow().contains(&core.pc()) {
                self.halt(Halt::Breakpoint);
                return true;
            }
        }
        core.run_singly();
        false
    }

    /// Why the chip is halted, if it is.
    pub fn halted(&self) -> Option<Halt> {
        self.halted.get()
    }

    /// Halts the chip before its next instruction.
    pub fn halt(&self, why: Halt) {
        self.halted.set(Some(why));
        self.update();
    }

    /// Lets the chip go on; with `step`, until an instruction is done.
    pub fn resume(&self, step: bool) {
        self.halted.set(None);
        self.stepping.set(step);
        self.passed.set(true);
        self.update();
    }

    /// Halts the chip whenever the instruction at this byte address is next.
    pub fn set_breakpoint(&self, address: u32) {
        self.breakpoints.borrow_mut().insert(address);
        self.update();
    }

    /// Removes a breakpoint; false if there was none.
    pub fn clear_breakpoint(&self, address: u32) -> bool {
        let removed = self.breakpoints.borrow_mut().remove(&address);
        self.update();
        removed
    }

    /// Removes all breakpoints.
    pub fn clear_breakpoints(&self) {
        self.breakpoints.borrow_mut().clear();
        self.update();
    }

    fn update(&self) {
        let something = self.is_halted() || self.stepping.get() || !self.breakpoints.borrow().is_empty();
        self.watching.set(something);
    }
}
