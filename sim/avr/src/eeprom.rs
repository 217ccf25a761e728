//! The EEPROM (datasheet section 8.4), with the time that programming takes.
//!
//! simavr finishes a write at once. In this model EEPE reads 1 while a cell is programmed, and the
//! cell changes at the end. Operations that the datasheet forbids meanwhile have no effect and are
//! violations. A reset does not stop a write; a loss of power leaves a wrong value in the cell.

use super::base::{Base, Timer};
use super::core::Vector;
use super::regs::{EEARH, EEARL, EECR, EEDR, EEMPE, EEPE, EEPM, EERE, EERIE};
use super::spm::{EepromActivity, Spm};
use sim_base::Cycles;

/// Erase only, or write only, in 1/34 of the time of both in one operation: 1.8 of 3.4 ms (table
/// 8-1).
const HALF_OPERATION: u32 = 18;
/// > EEMPE [...] hardware clears the bit to zero after four clock cycles. (section 8.6.3)
const MASTER_ENABLE_CYCLES: Cycles = 4;

/// Expires at the end of programming.
pub(super) const TIMER: Timer = Timer::Eeprom;

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
    /// An erased EEPROM with `bytes` bytes.
    pub fn new(bytes: usize) -> Eeprom {
        Eeprom { cells: vec![0xFF; bytes], programming: None, master_enable_until: 0 }
    }

    /// The cells. A cell that is being programmed has its old value.
    pub fn cells(&self) -> &[u8] {
        &self.cells
    }

    /// Sets cells from `address` on.
    pub fn set_cells(&mut self, address: usize, bytes: &[u8]) {
        let end = self.cells.len();
        assert!(address + bytes.len() <= end, "the EEPROM ends at {end:#x}");
        self.cells[address..address + bytes.len()].copy_from_slice(bytes);
    }

    /// `Writing` while a cell is programmed.
    pub fn activity(&self) -> EepromActivity {
        if self.programming.is_some() { EepromActivity::Writing } else { EepromActivity::Idle }
    }

    /// Resets the EEPROM's registers. Sets the timer of a write in progress again, because simavr's
    /// reset has cancelled it.
    pub fn reset(&mut self, base: &Base) {
        self.master_enable_until = 0;
        if let Some(programming) = self.programming {
            base.schedule(TIMER, programming.end);
        }
    }

    /// Handles a loss of power: a cell that is being programmed gets neither its old nor its new
    /// value.
    pub fn lose_power(&mut self, noise: u8) {
        if let Some(programming) = self.programming.take() {
            self.cells[programming.address] = programming.value ^ (noise | 1);
        }
    }

    /// Writes EECR.
    pub fn write_control(&mut self, base: &Base, spm: &mut Spm, value: u8) {
        let core = &base.core;
        let now = base.now();
        let busy = self.programming.is_some();
        let master_enabled = now < self.master_enable_until;
        let mode_mask = if busy { 0 } else { EEPM };
        let mode = core.get(EECR) & EEPM & !mode_mask | value & mode_mask;
        core.set(EECR, mode | value & EERIE);
        let address = self.address(base);
        if value & EEPE != 0 && master_enabled {
            self.master_enable_until = 0;
            if busy {
                base.report_violation(
                    "an EEPROM write is started while another goes on: it has no effect",
                );
            } else {
                self.program(base, spm, mode, address);
            }
        } else if value & EEMPE != 0 {
            self.master_enable_until = now + MASTER_ENABLE_CYCLES;
        } else if value & EEPE != 0 && !busy {
            // While busy, EEPE reads 1, and a read-modify-write of another bit writes it back. That
            // is not a mistake.
            base.report_violation(
                "EEPE is set without EEMPE in the four cycles before: no EEPROM write",
            );
        }
        if value & EERE != 0 {
            if busy {
                base.report_violation("the EEPROM is read while it is written: no effect");
            } else {
                core.set(EEDR, self.cells[address]);
                // > When the EEPROM is read, the CPU is halted for four clock cycles (section
                // > 8.6.3)
                core.set_cycle(core.cycle() + 4);
            }
        }
        self.request_level(base);
    }

    /// Reads EECR.
    pub fn read_control(&self, base: &Base) -> u8 {
        let stored = base.core.get(EECR) & (EEPM | EERIE);
        let busy = if self.programming.is_some() { EEPE } else { 0 };
        let enabled = if base.now() < self.master_enable_until { EEMPE } else { 0 };
        stored | busy | enabled
    }

    /// Writes EEARL or EEARH.
    pub fn write_address(&mut self, base: &Base, register: u16, value: u8) {
        if self.programming.is_some() {
            base.report_violation(
                "the EEPROM address is written while the EEPROM is written: no effect",
            );
        } else {
            base.core.set(register, value);
        }
    }

    /// Ends the programming of a cell.
    pub fn finish(&mut self, base: &Base) {
        if let Some(Programming { address, value, .. }) = self.programming.take() {
            self.cells[address] = value;
        }
        self.request_level(base);
    }

    /// > The EEPROM Ready interrupt generates a constant interrupt when EEPE is cleared. (section
    /// > 8.6.3)
    pub fn request_level(&self, base: &Base) {
        if self.programming.is_none() && base.core.get(EECR) & EERIE != 0 {
            base.core.raise(Vector::EepromReady);
        }
    }

    fn address(&self, base: &Base) -> usize {
        let address = u16::from_le_bytes([base.core.get(EEARL), base.core.get(EEARH)]);
        usize::from(address) % self.cells.len()
    }

    fn program(&mut self, base: &Base, spm: &mut Spm, mode: u8, address: usize) {
        let core = &base.core;
        // > The EEPROM can not be programmed during a CPU write to the Flash memory. (section
        // > 8.6.3)
        if spm.is_busy() {
            base.report_violation(
                "an EEPROM write is started while the flash is programmed: it has no effect",
            );
            return;
        }
        let data = core.get(EEDR);
        let silicon = base.silicon.get();
        let (both_us, half_us) = (silicon.eeprom_us, silicon.eeprom_us * HALF_OPERATION / 34);
        let (value, duration_us) = match mode >> 4 {
            0 => (data, both_us),
            1 => (0xFF, half_us),
            // Without an erase, bits can only become 0.
            2 => (self.cells[address] & data, half_us),
            _ => {
                base.report_violation("EEPM is 3, which is reserved: no EEPROM write");
                return;
            }
        };
        spm.lose_buffer(base);
        let end = base.now() + silicon.cycles_in_us(duration_us);
        self.programming = Some(Programming { address, value, end });
        base.schedule(TIMER, end);
        // > When EEPE has been set, the CPU is halted for two cycles before the next instruction is
        // > executed (section 8.6.3)
        core.set_cycle(core.cycle() + 2);
    }
}
