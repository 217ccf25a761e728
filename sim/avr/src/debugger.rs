//! A debugger's access to the chip from outside the run loop: halts and resumes it, reads and
//! writes registers and memories.
//!
//! Reading data space has no side effect: a register has the value that the program or the chip
//! wrote last. Writing an I/O register has the side effects of a program's store.

use std::rc::Rc;

use super::chip::Chip;
use super::core::Activity;
use super::debug::{Halt, Resume};
use super::machine::Machine;
use super::regs;

/// The registers of the processor.
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

/// A debugger's access to an [`Avr`](crate::Avr), from outside its run loop.
pub struct Debugger {
    machine: Rc<Machine>,
}

impl Debugger {
    pub(super) fn new(machine: Rc<Machine>) -> Debugger {
        Debugger { machine }
    }

    /// The type of the chip.
    pub fn chip(&self) -> Chip {
        self.machine.base.core.chip()
    }

    fn data_address(&self, address: u32) -> Option<u16> {
        u16::try_from(address).ok().filter(|address| *address <= self.chip().ram_end())
    }

    /// Reason for which the chip is halted; `None` if it is not.
    pub fn halted(&self) -> Option<Halt> {
        self.machine.debug.halted()
    }

    /// Halts the chip before its next instruction.
    pub fn halt(&self, why: Halt) {
        self.machine.debug.halt(why);
    }

    /// Resumes the chip. A step from sleep ends after the first instruction that follows the
    /// wake-up.
    pub fn resume(&self, how: Resume) {
        self.machine.debug.resume(how);
    }

    /// Removes all breakpoints and resumes the chip.
    pub fn detach(&self) {
        self.machine.debug.clear_breakpoints();
        self.machine.debug.resume(Resume::Run);
    }

    /// Sets a breakpoint at a byte address. The chip halts before the instruction there.
    pub fn set_breakpoint(&self, address: u32) {
        self.machine.debug.set_breakpoint(address);
    }

    /// Removes a breakpoint; false if there was none.
    pub fn clear_breakpoint(&self, address: u32) -> bool {
        self.machine.debug.clear_breakpoint(address)
    }

    /// True if the program counter left the flash that can be read.
    pub fn has_crashed(&self) -> bool {
        self.machine.base.core.activity() == Activity::Crashed
    }

    /// The registers.
    pub fn registers(&self) -> Registers {
        let core = &self.machine.base.core;
        Registers {
            r: std::array::from_fn(|index| core.get(index as u16)),
            sreg: core.sreg(),
            sp: u16::from_le_bytes([core.get(regs::SPL), core.get(regs::SPH)]),
            pc: core.pc(),
        }
    }

    /// Sets all registers. The program counter wraps at the end of the flash.
    pub fn set_registers(&self, registers: &Registers) {
        let core = &self.machine.base.core;
        for (index, value) in registers.r.iter().enumerate() {
            core.set(index as u16, *value);
        }
        let [spl, sph] = registers.sp.to_le_bytes();
        core.set(regs::SPL, spl);
        core.set(regs::SPH, sph);
        core.set_sreg(registers.sreg);
        core.set_pc(registers.pc % core.chip().flash_bytes() as u32);
    }

    /// A byte of the data space; `None` if the address does not exist.
    pub fn data(&self, address: u32) -> Option<u8> {
        let address = self.data_address(address)?;
        Some(if address == regs::SREG {
            self.machine.base.core.sreg()
        } else {
            self.machine.peek(address)
        })
    }

    /// Stores a byte in the data space; false if the address does not exist.
    pub fn set_data(&self, address: u32, value: u8) -> bool {
        let Some(address) = self.data_address(address) else { return false };
        match address {
            regs::SREG => self.machine.base.core.set_sreg(value),
            regs::IO_FIRST..regs::RAMSTART => self.machine.store(address, value),
            _ => self.machine.base.core.set(address, value),
        }
        true
    }

    /// A byte of flash; `None` if the address does not exist.
    pub fn flash(&self, address: u32) -> Option<u8> {
        let address = address as usize;
        let exists = address < self.chip().flash_bytes();
        exists.then(|| self.machine.base.core.flash(address..address + 1)[0])
    }

    /// A byte of EEPROM; `None` if the address does not exist.
    pub fn eeprom(&self, address: u32) -> Option<u8> {
        self.machine.peripherals.nvm.eeprom.borrow().cells().get(address as usize).copied()
    }

    /// Sets a byte of EEPROM; false if the address does not exist.
    pub fn set_eeprom(&self, address: u32, value: u8) -> bool {
        let exists = (address as usize) < self.chip().eeprom_bytes();
        if exists {
            self.machine.peripherals.nvm.eeprom.borrow_mut().set_cells(address as usize, &[value]);
        }
        exists
    }
}
