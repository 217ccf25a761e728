//! What a debugger needs of the chip: to stop it before an instruction, to let it go on or make one step, and to see and
//! set its registers and memories.
//!
//! Breakpoints are kept beside the flash, not in it, so there may be any number and the program sees none. Only while one
//! is set, or a step is made, does the core run instruction by instruction; otherwise the run loop tests one flag. A
//! chip that is halted lets no time pass: its clock, and what is clocked by it, stands still.
//!
//! Reading data space has no side effect: a register reads as it was last written, or as the chip last set it. Writing
//! to an I/O register acts as a program's store does.

use std::cell::{Cell, RefCell};
use std::collections::HashSet;
use std::rc::Rc;

use super::chip::Chip;
use super::core::{Activity, Core};
use super::machine::Machine;
use super::regs;

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

/// The part of the run loop that looks after a debugger.
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

    fn halt(&self, why: Halt) {
        self.halted.set(Some(why));
        self.update();
    }

    fn resume(&self, step: bool) {
        self.halted.set(None);
        self.stepping.set(step);
        self.passed.set(true);
        self.update();
    }

    fn update(&self) {
        let something = self.is_halted() || self.stepping.get() || !self.breakpoints.borrow().is_empty();
        self.watching.set(something);
    }
}

/// The registers that a debugger shows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Registers {
    /// R0 to R31.
    pub r: [u8; 32],
    /// Status register.
    pub sreg: u8,
    /// Stack pointer.
    pub sp: u16,
    /// Program counter, as a byte address.
    pub pc: u32,
}

/// A debugger's access to an [`Avr`](super::Avr), from outside its run loop.
pub struct Debugger {
    machine: Rc<Machine>,
}

impl Debugger {
    pub(super) fn new(machine: Rc<Machine>) -> Debugger {
        Debugger { machine }
    }

    /// Which chip it is.
    pub fn chip(&self) -> Chip {
        self.machine.core.chip()
    }

    fn data_address(&self, address: u32) -> Option<u16> {
        u16::try_from(address).ok().filter(|address| *address <= self.chip().ram_end())
    }

    /// Why the chip is halted, if it is.
    pub fn halted(&self) -> Option<Halt> {
        self.machine.debug.halted.get()
    }

    /// Halts the chip before its next instruction.
    pub fn halt(&self, why: Halt) {
        self.machine.debug.halt(why);
    }

    /// Lets the chip go on; with `step`, until an instruction is done. A step from sleep ends after the instruction that
    /// follows the wake-up.
    pub fn resume(&self, step: bool) {
        self.machine.debug.resume(step);
    }

    /// Removes all breakpoints and lets the chip go on.
    pub fn detach(&self) {
        self.machine.debug.breakpoints.borrow_mut().clear();
        self.machine.debug.resume(false);
    }

    /// Halts the chip whenever the instruction at this byte address is next.
    pub fn set_breakpoint(&self, address: u32) {
        self.machine.debug.breakpoints.borrow_mut().insert(address);
        self.machine.debug.update();
    }

    /// Removes a breakpoint; false if there was none.
    pub fn clear_breakpoint(&self, address: u32) -> bool {
        let removed = self.machine.debug.breakpoints.borrow_mut().remove(&address);
        self.machine.debug.update();
        removed
    }

    /// Whether the program ran off the flash that can be read.
    pub fn has_crashed(&self) -> bool {
        self.machine.core.activity() == Activity::Crashed
    }

    /// The registers.
    pub fn registers(&self) -> Registers {
        let core = &self.machine.core;
        Registers {
            r: std::array::from_fn(|index| core.get(index as u16)),
            sreg: core.sreg(),
            sp: u16::from_le_bytes([core.get(regs::SPL), core.get(regs::SPH)]),
            pc: core.pc(),
        }
    }

    /// Sets all registers. The program counter is kept inside the flash.
    pub fn set_registers(&self, registers: &Registers) {
        let core = &self.machine.core;
        for (index, value) in registers.r.iter().enumerate() {
            core.set(index as u16, *value);
        }
        let [spl, sph] = registers.sp.to_le_bytes();
        core.set(regs::SPL, spl);
        core.set(regs::SPH, sph);
        core.set_sreg(registers.sreg);
        core.set_pc(registers.pc % core.chip().flash_bytes() as u32);
    }

    /// A byte of the data space, if there is one at that address.
    pub fn data(&self, address: u32) -> Option<u8> {
        let address = self.data_address(address)?;
        Some(if address == regs::SREG { self.machine.core.sreg() } else { self.machine.core.get(address) })
    }

    /// Stores a byte in the data space; false if there is none at that address.
    pub fn set_data(&self, address: u32, value: u8) -> bool {
        let Some(address) = self.data_address(address) else { return false };
        match address {
            regs::SREG => self.machine.core.set_sreg(value),
            regs::IO_FIRST..regs::RAMSTART => self.machine.core.store(address, value),
            _ => self.machine.core.set(address, value),
        }
        true
    }

    /// A byte of flash, if there is one at that address.
    pub fn flash(&self, address: u32) -> Option<u8> {
        self.machine.core.flash().get(address as usize).copied()
    }

    /// A byte of EEPROM, if there is one at that address.
    pub fn eeprom(&self, address: u32) -> Option<u8> {
        self.machine.eeprom.borrow().cells().get(address as usize).copied()
    }

    /// Sets a byte of EEPROM; false if there is none at that address.
    pub fn set_eeprom(&self, address: u32, value: u8) -> bool {
        let exists = (address as usize) < self.chip().eeprom_bytes();
        if exists {
            self.machine.eeprom.borrow_mut().set_cells(address as usize, &[value]);
        }
        exists
    }
}
