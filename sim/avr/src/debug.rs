//! The debugger's part of the run loop: halts the chip before an instruction, resumes it, or lets
//! it run one instruction.
//!
//! The breakpoints are a list beside the flash. So their number has no limit, and the program
//! cannot see them. Only with a breakpoint or during a step does the core run instruction by
//! instruction; otherwise the run loop tests one flag. While the chip is halted, its clock stops.

use std::cell::{Cell, RefCell};
use std::collections::HashSet;

use super::core::{Activity, Core};

/// Reason for which the chip is halted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Halt {
    /// The debugger halted the chip.
    Asked,
    /// The next instruction has a breakpoint.
    Breakpoint,
    /// A step is complete.
    Stepped,
    /// The program counter left the flash that can be read.
    Crashed,
}

/// How a debugger resumes the chip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Resume {
    /// Run until a breakpoint.
    Run,
    /// Run one instruction.
    Step,
}

/// State of the debugger in the run loop.
#[derive(Debug, Default)]
pub(super) struct Debug {
    breakpoints: RefCell<HashSet<u32>>,
    halted: Cell<Option<Halt>>,
    stepping: Cell<bool>,
    /// True if the next instruction runs without a check, after a resume.
    passed: Cell<bool>,
    /// True if the run loop must call `halts` before each instruction.
    watching: Cell<bool>,
}

impl Debug {
    /// True if the run loop must call [`Debug::halts`] before each instruction.
    #[inline]
    pub fn is_watching(&self) -> bool {
        self.watching.get()
    }

    /// True if the chip is halted.
    pub fn is_halted(&self) -> bool {
        self.halted.get().is_some()
    }

    /// Checks before an instruction whether the chip halts there. If not, lets the core run only
    /// that instruction.
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

    /// Reason for which the chip is halted; `None` if it is not.
    pub fn halted(&self) -> Option<Halt> {
        self.halted.get()
    }

    /// Halts the chip before its next instruction.
    pub fn halt(&self, why: Halt) {
        self.halted.set(Some(why));
        self.update();
    }

    /// Resumes the chip.
    pub fn resume(&self, how: Resume) {
        self.halted.set(None);
        self.stepping.set(how == Resume::Step);
        self.passed.set(true);
        self.update();
    }

    /// Sets a breakpoint at a byte address. The chip halts before the instruction there.
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
        let something =
            self.is_halted() || self.stepping.get() || !self.breakpoints.borrow().is_empty();
        self.watching.set(something);
    }
}
