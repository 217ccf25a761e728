//! Register reads and writes with their side effects, and the modes in which they are allowed.
//!
//! Every SPI write goes through `write` (all bits) or `bit_modify` (the masked bits).
//! Side effects happen only for bits in the mask, so that a BIT MODIFY of one bit does not repeat
//! the requests of its neighbours.
//!
//! Source: DS20001801J sections 6.6, 6.7, 7, 10.1, 11 and 12.10.

use super::registers::{self, Kind, eflg, int, txrtsctrl};
use super::{Mcp2515, Mode};
use can_model::ErrorState;
use sim_base::Cycles;

/// Limits of the error counters (Register 6-3).
const WARNING_LIMIT: u16 = 96;
const PASSIVE_LIMIT: u16 = 128;

impl Mcp2515 {
    /// The value that a READ of the register returns now. Reading has no side effects.
    pub fn register(&self, address: u8) -> u8 {
        let address = address & registers::ADDRESS_MASK;
        let stored = self.registers[usize::from(address)];
        match registers::kind(address) {
            // 4.5: masks and filters read as 0 outside configuration mode.
            Kind::Filter if self.mode != Mode::Configuration => 0,
            Kind::Canstat => self.mode.code() << 5 | self.interrupt_code() << 1,
            Kind::Canctrl => self.registers[usize::from(registers::CANCTRL)],
            Kind::ErrorCounter if address == registers::TEC => counter(self.can.tec()),
            Kind::ErrorCounter => counter(self.can.rec()),
            Kind::Eflg => stored | self.error_flags,
            // Digital inputs show the level of their pins, which are unconnected and so pulled up;
            // pins in request-to-send mode read as 0 (3.5, Register 3-2).
            Kind::ConfigOnly if address == registers::TXRTSCTRL => {
                stored | (!stored & txrtsctrl::MODES) << txrtsctrl::PINS_SHIFT
            }
            _ => stored,
        }
    }

    /// True if the driver has written to the register since power-up.
    pub fn is_written(&self, address: u8) -> bool {
        self.written >> (address & registers::ADDRESS_MASK) & 1 != 0
    }

    pub(super) fn write(&mut self, address: u8, value: u8, at: Cycles) {
        self.write_bits(address, value, 0xFF, at);
    }

    pub(super) fn bit_modify(&mut self, address: u8, mask: u8, value: u8, at: Cycles) {
        if registers::is_bit_modifiable(address) {
            self.write_bits(address, value, mask, at);
        } else {
            let name = registers::name(address);
            self.violation(
                at,
                format!(
                    "BIT MODIFY of {name} (mask {mask:02X}h, data {value:02X}h), which does not \
                     allow it: the mask is forced to FFh (DS20001801J 12.10)"
                ),
            );
            self.write(address, value, at);
        }
    }

    fn write_bits(&mut self, address: u8, value: u8, mask: u8, at: Cycles) {
        let index = usize::from(address);
        self.written |= 1 << (address & registers::ADDRESS_MASK);
        match registers::kind(address) {
            Kind::Filter | Kind::ConfigOnly if self.mode != Mode::Configuration => {
                self.reject(address, value, "writable only in configuration mode", "10.1", at);
            }
            Kind::TxBuffer(n) if self.is_tx_requested(n) => {
                self.reject(address, value, "its TXREQ is set", "3.1", at);
            }
            Kind::ErrorCounter | Kind::RxBuffer(_) => {
                self.reject(address, value, "read-only", "11", at);
            }
            // Also read-only, but a sequential WRITE may pass over it to CANCTRL.
            Kind::Canstat => {}
            Kind::Canctrl => self.write_canctrl(value, mask, at),
            Kind::Canintf => self.write_canintf(value, mask, at),
            Kind::TxControl(n) => self.write_tx_control(n, value, mask, at),
            Kind::RxControl(n) => self.write_rx_control(n, value, mask, at),
            Kind::Filter
            | Kind::ConfigOnly
            | Kind::TxBuffer(_)
            | Kind::Bfpctrl
            | Kind::Caninte
            | Kind::Eflg => {
                let mask = mask & registers::writable(address);
                self.registers[index] = self.registers[index] & !mask | value & mask;
            }
        }
    }

    fn reject(&mut self, address: u8, value: u8, why: &str, section: &str, at: Cycles) {
        let name = registers::name(address);
        self.violation(
            at,
            format!("{name} <- {value:02X}h ignored: {why} (DS20001801J {section})"),
        );
    }

    pub(super) fn write_canintf(&mut self, value: u8, mask: u8, at: Cycles) {
        let index = usize::from(registers::CANINTF);
        let old = self.registers[index];
        let mut new = old & !mask | value & mask;
        // 7.7: a flag cannot be cleared while its condition lasts.
        let overflow = self.registers[usize::from(registers::EFLG)] & (eflg::RX0OVR | eflg::RX1OVR);
        if overflow != 0 {
            new |= old & int::ERR;
        }
        self.registers[index] = new;
        for n in 0..2 {
            if old & !new & (int::RX0 << n) != 0 {
                self.rx_flag_cleared(n, at);
            }
        }
        if new & !old & int::WAK != 0 {
            self.wake_by_driver(at);
        }
    }

    /// Sets an interrupt flag.
    pub(super) fn raise(&mut self, flag: u8) {
        self.registers[usize::from(registers::CANINTF)] |= flag;
    }

    fn enabled_interrupts(&self) -> u8 {
        self.registers[usize::from(registers::CANINTF)]
            & self.registers[usize::from(registers::CANINTE)]
    }

    /// Level of the INT pin: high (`true`) if no enabled interrupt is pending.
    pub fn int_pin(&self) -> bool {
        self.enabled_interrupts() == 0
    }

    /// ICOD (Table 7-1): the pending enabled interrupt of the highest priority. MERRF has no code.
    fn interrupt_code(&self) -> u8 {
        const BY_PRIORITY: [u8; 7] =
            [int::ERR, int::WAK, int::TX0, int::TX0 << 1, int::TX0 << 2, int::RX0, int::RX1];
        let pending = self.enabled_interrupts();
        BY_PRIORITY.iter().position(|flag| pending & flag != 0).map_or(0, |n| n as u8 + 1)
    }

    /// The read-only bits of EFLG, from the engine's state.
    pub(super) fn current_error_flags(&self) -> u8 {
        let (tec, rec) = (self.can.tec(), self.can.rec());
        let mut flags = 0;
        let mut set = |condition: bool, bit: u8| flags |= if condition { bit } else { 0 };
        set(self.can.error_state() == ErrorState::BusOff, eflg::TXBO);
        set(tec >= PASSIVE_LIMIT, eflg::TXEP);
        set(rec >= PASSIVE_LIMIT, eflg::RXEP);
        set(tec >= WARNING_LIMIT, eflg::TXWAR | eflg::EWARN);
        set(rec >= WARNING_LIMIT, eflg::RXWAR | eflg::EWARN);
        flags
    }

    /// Updates EFLG from the engine's error state. A change sets ERRIF (7.6).
    pub(super) fn follow_errors(&mut self) {
        let flags = self.current_error_flags();
        if flags != self.error_flags {
            self.error_flags = flags;
            self.raise(int::ERR);
        }
    }
}

/// TEC and REC have eight bits; the engine's counter continues in bus-off.
fn counter(count: u16) -> u8 {
    count.min(0xFF) as u8
}
