//! The nonvolatile memories, EEPROM and flash. The program can change only one of them at a time.

use std::cell::RefCell;

use super::base::{Base, Peripheral, Timer};
use super::chip::Chip;
use super::eeprom::{self, Eeprom};
use super::regs::{EEARH, EEARL, EECR, SPMCSR};
use super::spm::{self, Spm};
use sim_base::Cycles;
use sim_base::Noise;

/// The model of EEPROM and self-programming.
pub(super) struct Nvm {
    pub eeprom: RefCell<Eeprom>,
    pub spm: RefCell<Spm>,
}

impl Nvm {
    /// Executes SPM for the program, with these values of Z and R1:R0.
    pub fn execute_spm(&self, base: &Base, z: u16, word: u16) {
        self.spm.borrow_mut().execute(base, self.eeprom.borrow().activity(), z, word);
    }
}

impl Peripheral for Nvm {
    fn for_chip(chip: Chip) -> Nvm {
        Nvm {
            eeprom: RefCell::new(Eeprom::new(chip.eeprom_bytes())),
            spm: RefCell::new(Spm::new(chip)),
        }
    }

    fn writes(&self) -> &'static [u16] {
        &[EECR, EEARL, EEARH, SPMCSR]
    }

    fn reads(&self) -> &'static [u16] {
        &[EECR, SPMCSR]
    }

    fn timers(&self) -> &'static [Timer] {
        &[eeprom::TIMER, spm::TIMER]
    }

    fn write(&self, base: &Base, address: u16, value: u8) {
        match address {
            EECR => self.eeprom.borrow_mut().write_control(base, &mut self.spm.borrow_mut(), value),
            SPMCSR => {
                self.spm.borrow_mut().write_control(base, self.eeprom.borrow().activity(), value)
            }
            _ => self.eeprom.borrow_mut().write_address(base, address, value),
        }
    }

    fn read(&self, base: &Base, address: u16) -> u8 {
        match address {
            EECR => self.eeprom.borrow().read_control(base),
            _ => self.spm.borrow().read_control(base),
        }
    }

    fn expire(&self, base: &Base, timer: Timer, _: Cycles) {
        if timer == eeprom::TIMER {
            self.eeprom.borrow_mut().finish(base);
            self.spm.borrow().update(base, self.eeprom.borrow().activity());
        } else {
            self.spm.borrow_mut().finish(base, self.eeprom.borrow().activity());
        }
    }

    fn reset(&self, base: &Base, noise: &mut Noise) {
        self.eeprom.borrow_mut().reset(base);
        self.spm.borrow_mut().reset(base, noise);
    }

    fn interrupt_returns(&self, base: &Base) {
        self.eeprom.borrow().request_level(base);
        self.spm.borrow().update(base, self.eeprom.borrow().activity());
    }
}
