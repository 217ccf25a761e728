//! The EEPROM (datasheet section 8.4), with the time that programming takes.
//!
//! simavr finishes a write at once. Here EEPE reads 1 while the cell is programmed, the cell
//! changes at the end of that, and what the datasheet forbids meanwhile has no effect and is a
//! violation. A reset lets a write finish, a loss of power leaves the cell with something else.

use super::core::Vector;
use super::machine::{Machine, Timer};
use super::regs::{EEARH, EEARL, EECR, EEDR, EEMPE, EEPE, EEPM, EERE, EERIE};
use sim_base::{Cycles, F_CPU_HZ};

/// Erase and write in one operation (table 8-1).
const ERASE_AND_WRITE_CYCLES: Cycles = F_CPU_HZ * 34 / 10_000;
/// Erase only, or write only (table 8-1).
const HALF_OPERATION_CYCLES: Cycles = F_CPU_HZ * 18 / 10_000;
/// > EEMPE [...] hardware clears the bit to zero after four clock cycles. (section 8.6.3)
const MASTER_ENABLE_CYCLES: Cycles = 4;

#[derive(Debug, Clone, Copy)]
struct Programming {
    address: usize,
    value: u8,
    end: Cycles,
}

/// EEPROM cells and the operation in progress.
#[derive(Debug)]
pub(super) struct Eeprom {
    cells: Vec<u8>,
    programming: Option<Programming>,
    master_enable_until: Cycles,
}

impl Eeprom {
    /// An erased EEPROM of that many bytes.
    pub fn new(bytes: usize) -> Eeprom {
        Eeprom { cells: vec![0xFF; bytes], programming: None, master_enable_until: 0 }
    }

    /// The cells; a cell in programming still has its old value.
    pub fn cells(&self) -> &[u8] {
        &self.cells
    }

    /// Sets cells from `address` on.
    pub fn set_cells(&mut self, address: usize, bytes: &[u8]) {
        let end = self.cells.len();
        assert!(address + bytes.len() <= end, "the EEPROM ends at {end:#x}");
        self.cells[address..address + bytes.len()].copy_from_slice(bytes);
    }

    /// True while a cell is programmed.
    pub fn is_busy(&self) -> bool {
        self.programming.is_some()
    }

    /// A reset. The date of a programming in progress must be made again, simavr forgot it.
    pub fn reset(&mut self, machine: &Machine) {
        self.master_enable_until = 0;
        if let Some(programming) = self.programming {
            machine.schedule(Timer::Eeprom, programming.end);
        }
    }

    /// The supply failed: a cell in programming holds neither the old value nor the new.
    pub fn lose_power(&mut self, noise: u8) {
        if let Some(programming) = self.programming.take() {
            self.cells[programming.address] = programming.value ^ (noise | 1);
        }
    }

    /// Writes EECR.
    pub fn write_control(&mut self, machine: &Machine, value: u8) {
        let core = &machine.core;
        let now = machine.now();
        let busy = self.programming.is_some();
        let master_enabled = now < self.master_enable_until;
        let mode_mask = if busy { 0 } else { EEPM };
        let mode = core.get(EECR) & EEPM & !mode_mask | value & mode_mask;
        core.set(EECR, mode | value & EERIE);
        let address = self.address(machine);
        if value & EEPE != 0 && master_enabled {
            self.master_enable_until = 0;
            if busy {
                machine.violation("an EEPROM write is started while another goes on: it has no effect");
            } else {
                self.program(machine, mode, address);
            }
        } else if value & EEMPE != 0 {
            self.master_enable_until = now + MASTER_ENABLE_CYCLES;
        } else if value & EEPE != 0 && !busy {
            // While busy, EEPE reads 1, and a read-modify-write of another bit writes it back: no
            // mistake.
            machine.violation("EEPE is set without EEMPE in the four cycles before: no EEPROM write");
        }
        if value & EERE != 0 {
            if busy {
                machine.violation("the EEPROM is read while it is written: no effect");
            } else {
                core.set(EEDR, self.cells[address]);
                // > When the EEPROM is read, the CPU is halted for four clock cycles (section
                // > 8.6.3)
                core.set_cycle(core.cycle() + 4);
            }
        }
        self.request_level(machine);
    }

    /// Reads EECR.
    pub fn read_control(&self, machine: &Machine) -> u8 {
        let stored = machine.core.get(EECR) & (EEPM | EERIE);
        let busy = if self.programming.is_some() { EEPE } else { 0 };
        let enabled = if machine.now() < self.master_enable_until { EEMPE } else { 0 };
        stored | busy | enabled
    }

    /// Writes EEARL or EEARH.
    pub fn write_address(&mut self, machine: &Machine, register: u16, value: u8) {
        if self.programming.is_some() {
            machine.violation("the EEPROM address is written while the EEPROM is written: no effect");
        } else {
            machine.core.set(register, value);
        }
    }

    /// Programming is over.
    pub fn finish(&mut self, machine: &Machine) {
        if let Some(Programming { address, value, .. }) = self.programming.take() {
            self.cells[address] = value;
        }
        self.request_level(machine);
    }

    /// > The EEPROM Ready interrupt generates a constant interrupt when EEPE is cleared. (section
    /// > 8.6.3)
    pub fn request_level(&self, machine: &Machine) {
        if self.programming.is_none() && machine.core.get(EECR) & EERIE != 0 {
            machine.core.raise(Vector::EepromReady);
        }
    }

    fn address(&self, machine: &Machine) -> usize {
        let address = u16::from_le_bytes([machine.core.get(EEARL), machine.core.get(EEARH)]);
        usize::from(address) % self.cells.len()
    }

    fn program(&mut self, machine: &Machine, mode: u8, address: usize) {
        let core = &machine.core;
        let mut spm = machine.spm.borrow_mut();
        // > The EEPROM can not be programmed during a CPU write to the Flash memory. (section 8.6.3)
        if spm.is_busy() {
            machine.violation("an EEPROM write is started while the flash is programmed: it has no effect");
            return;
        }
        let data = core.get(EEDR);
        let (value, duration) = match mode >> 4 {
            0 => (data, ERASE_AND_WRITE_CYCLES),
            1 => (0xFF, HALF_OPERATION_CYCLES),
            // Without an erase, bits can only become 0.
            2 => (self.cells[address] & data, HALF_OPERATION_CYCLES),
            _ => {
                machine.violation("EEPM is 3, which is reserved: no EEPROM write");
                return;
            }
        };
        spm.lose_buffer(machine);
        let end = machine.now() + duration;
        self.programming = Some(Programming { address, value, end });
        machine.schedule(Timer::Eeprom, end);
        // > When EEPE has been set, the CPU is halted for two cycles before the next instruction is
        // > executed (section 8.6.3)
        core.set_cycle(core.cycle() + 2);
    }
}
