//! Faults of the chip that the driver does not cause: a dip of the supply, a bit that flips, a chip that ignores instructions.
//!
//! Limits: a dip of the supply ends what was being sent, and asks for nothing to be sent; the buffers' contents are garbage.

use super::registers::{self, Kind, canctrl, txctrl};
use super::{Mcp2515, Mode};
use sim_base::Cycles;
use sim_base::Noise;

impl Mcp2515 {
    /// Flips bits of a register: what a particle or a spike does. In CANCTRL this is a request for another mode; registers
    /// that only the chip writes (CANSTAT, the error counters, EFLG) keep what they have.
    pub fn flip_bits(&mut self, address: u8, mask: u8, at: Cycles) {
        let address = address & registers::ADDRESS_MASK;
        let stored = self.registers[usize::from(address)];
        match registers::kind(address) {
            Kind::Canctrl => self.write_canctrl(stored ^ mask, mask, at),
            Kind::Canstat | Kind::ErrorCounter | Kind::Eflg => {}
            Kind::Canintf => self.write_canintf(stored ^ mask, mask, at),
            Kind::TxControl(n) => self.write_tx_control(n, stored ^ mask, mask, at),
            _ => self.registers[usize::from(address)] = stored ^ mask & registers::writable(address),
        }
    }

    /// The supply dips: all registers hold garbage, the mode too, and the chip goes on with that. Equal seeds give equal
    /// garbage.
    pub fn brown_out(&mut self, seed: u64, at: Cycles) {
        self.reset(at);
        self.deaf_until = at;
        let mut garbage = Noise::new(seed);
        for address in 0..registers::SIZE as u8 {
            let byte = garbage.next_u64() as u8 & registers::writable(address);
            match registers::kind(address) {
                Kind::Canctrl | Kind::Canstat | Kind::Eflg => {}
                Kind::TxControl(_) => self.registers[usize::from(address)] = byte & !txctrl::TXREQ,
                _ => self.registers[usize::from(address)] = byte,
            }
        }
        const MODES: [Mode; 5] = [Mode::Normal, Mode::Sleep, Mode::Loopback, Mode::ListenOnly, Mode::Configuration];
        let mode = MODES[garbage.below(MODES.len() as u64) as usize];
        let rest = garbage.next_u64() as u8 & !(canctrl::REQOP | canctrl::ABAT);
        self.registers[usize::from(registers::CANCTRL)] = mode.code() << 5 | rest;
        self.be_in(mode);
    }

    /// The chip falls asleep by itself.
    pub fn fall_asleep(&mut self, at: Cycles) {
        self.reset_transmit();
        let canctrl = &mut self.registers[usize::from(registers::CANCTRL)];
        *canctrl = *canctrl & !canctrl::REQOP | Mode::Sleep.code() << 5;
        self.waking_until = None;
        self.deaf_until = at;
        self.be_in(Mode::Sleep);
    }

    /// Whether the chip stays in configuration mode whatever is asked of it. It goes there at once.
    pub fn hold_in_configuration(&mut self, held: bool) {
        self.is_held = held;
        if held {
            self.reset_transmit();
            self.be_in(Mode::Configuration);
        }
    }

    fn be_in(&mut self, mode: Mode) {
        self.joining = None;
        self.start_engine(mode);
        self.enter(mode);
        // The garbage in CNF1 to CNF3 is not the driver's mistake.
        self.timing_checked = mode != Mode::Configuration;
    }
}
