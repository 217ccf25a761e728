//! Faults of the chip that the driver does not cause: a brown-out, a flipped bit, a chip that
//! ignores instructions.
//!
//! Limits: a brown-out aborts the frame on the bus and requests no transmission; the buffers'
//! contents are garbage.

use super::registers::{self, Kind, canctrl, txctrl};
use super::{Mcp2515, Mode};
use sim_base::Cycles;
use sim_base::Noise;

impl Mcp2515 {
    /// Flips bits of a register, as a particle or a spike does. In CANCTRL this requests another
    /// mode. Registers that only the chip writes (CANSTAT, the error counters, EFLG) do not
    /// change.
    pub fn flip_bits(&mut self, address: u8, mask: u8, at: Cycles) {
        let address = address & registers::ADDRESS_MASK;
        let stored = self.registers[usize::from(address)];
        match registers::kind(address) {
            Kind::Canctrl => self.write_canctrl(stored ^ mask, mask, at),
            Kind::Canstat | Kind::ErrorCounter | Kind::Eflg => {}
            Kind::Canintf => self.write_canintf(stored ^ mask, mask, at),
            Kind::TxControl(n) => self.write_tx_control(n, stored ^ mask, mask, at),
            _ => {
                self.registers[usize::from(address)] = stored ^ mask & registers::writable(address)
            }
        }
    }

    /// A brown-out: all registers and the mode are garbage, and the chip continues with them. Equal
    /// seeds give equal garbage.
    pub fn brown_out(&mut self, seed: u64, at: Cycles) {
        self.reset(at);
        self.deaf_until = at;
        self.settled_at = at;
        let mut garbage = Noise::new(seed);
        for address in 0..registers::SIZE as u8 {
            let byte = garbage.next_u64() as u8 & registers::writable(address);
            match registers::kind(address) {
                Kind::Canctrl | Kind::Canstat | Kind::Eflg => {}
                Kind::TxControl(_) => self.registers[usize::from(address)] = byte & !txctrl::TXREQ,
                _ => self.registers[usize::from(address)] = byte,
            }
        }
        const MODES: [Mode; 5] =
            [Mode::Normal, Mode::Sleep, Mode::Loopback, Mode::ListenOnly, Mode::Configuration];
        let mode = MODES[garbage.below(MODES.len() as u64) as usize];
        let rest = garbage.next_u64() as u8 & !(canctrl::REQOP | canctrl::ABAT);
        self.registers[usize::from(registers::CANCTRL)] = mode.code() << 5 | rest;
        self.force_mode(mode);
    }

    /// The chip enters sleep by itself.
    pub fn fall_asleep(&mut self, at: Cycles) {
        self.reset_transmit();
        let canctrl = &mut self.registers[usize::from(registers::CANCTRL)];
        *canctrl = *canctrl & !canctrl::REQOP | Mode::Sleep.code() << 5;
        self.waking_until = None;
        self.deaf_until = at;
        self.settled_at = at;
        self.force_mode(Mode::Sleep);
    }

    /// Holds the chip in configuration mode (at once), or releases it.
    pub fn hold_in_configuration(&mut self, held: bool) {
        self.is_held = held;
        if held {
            self.reset_transmit();
            self.force_mode(Mode::Configuration);
        }
    }

    fn force_mode(&mut self, mode: Mode) {
        self.joining = None;
        self.start_engine(mode);
        self.enter(mode);
        // The garbage in CNF1 to CNF3 is not a driver mistake.
        self.is_timing_checked = mode != Mode::Configuration;
    }
}
