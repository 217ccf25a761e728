//! The SPI as a master (datasheet section 19), with one device on it.
//!
//! simavr restarts a transfer when SPDR is written during it; the chip ignores the write and sets
//! WCOL. This model does as the chip does, clears SPIF and WCOL as section 19.5 says, and lets a
//! byte reach the device only if SCK is an output. A program's mistakes become violations. Not
//! modelled: slave mode, the phase of the SCK divider.

use super::core::Vector;
use super::machine::{Machine, Timer};
use super::regs::{CPHA, CPOL, DDRB, DORD, MSTR, SPCR, SPDR, SPE, SPI2X, SPIF, SPR, SPSR, WCOL};
use sim_base::Cycles;

/// Pins of port B.
const SS: u8 = 1 << 2;
const MOSI: u8 = 1 << 3;
const SCK: u8 = 1 << 5;

/// One byte on the SPI, as the device sees it when its last bit is over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SpiByte {
    /// The byte as the device understands it, most significant bit first on the wire.
    pub mosi: u8,
    /// When SPDR was written.
    pub start: Cycles,
    /// When the last bit was over.
    pub end: Cycles,
    /// Length of an SCK period in CPU cycles.
    pub cycles_per_bit: u64,
    /// SPI mode: CPOL * 2 + CPHA.
    pub mode: u8,
}

/// The SPI's registers and its transfer in progress.
#[derive(Debug, Default)]
pub(super) struct Spi {
    in_transfer: Option<SpiByte>,
    received: u8,
    /// SPSR was read with SPIF or WCOL set: the next access of SPDR clears them.
    status_seen: bool,
}

impl Spi {
    /// Writes SPDR: starts a transfer.
    pub fn write_data(&mut self, machine: &Machine, value: u8) {
        let core = &machine.core;
        let control = core.get(SPCR);
        if control & SPE == 0 {
            machine.violation("SPDR is written while the SPI is off");
            return;
        }
        if control & MSTR == 0 {
            machine.violation("SPDR is written while the SPI is a slave, which is not modelled");
            return;
        }
        if self.in_transfer.is_some() {
            core.set_bits(SPSR, WCOL);
            machine.violation("SPDR is written during a transfer: the byte is lost (WCOL)");
            return;
        }
        self.clear_flags_if_seen(machine);
        if core.get(DDRB) & SS == 0 {
            machine.violation("SS (PB2) is an input while the SPI is master: a low level there ends master mode");
        }
        let divisor = [4, 16, 64, 128][usize::from(control & SPR)];
        let cycles_per_bit = if core.get(SPSR) & SPI2X != 0 { divisor / 2 } else { divisor };
        let start = machine.now();
        let end = start + 8 * cycles_per_bit;
        let mode = (control & (CPOL | CPHA)) >> 2;
        self.in_transfer = Some(SpiByte { mosi: value, start, end, cycles_per_bit, mode });
        machine.schedule(Timer::Spi, end);
        machine.spi_transfer_begins(start);
    }

    /// Reads SPDR.
    pub fn read_data(&mut self, machine: &Machine) -> u8 {
        self.clear_flags_if_seen(machine);
        self.received
    }

    /// Reads SPSR.
    pub fn read_status(&mut self, machine: &Machine) -> u8 {
        let status = machine.core.get(SPSR);
        self.status_seen = status & (SPIF | WCOL) != 0;
        status
    }

    /// Writes SPSR: only SPI2X can be.
    pub fn write_status(&mut self, machine: &Machine, value: u8) {
        let status = machine.core.get(SPSR);
        machine.core.set(SPSR, status & !SPI2X | value & SPI2X);
    }

    /// Writes SPCR. Switching the SPI off ends a transfer.
    pub fn write_control(&mut self, machine: &Machine, value: u8) {
        machine.core.set(SPCR, value);
        if value & SPE == 0 && self.in_transfer.take().is_some() {
            machine.unschedule(Timer::Spi);
            machine.violation("the SPI is switched off during a transfer");
        }
    }

    /// The transfer is over: what the device gets, if anything reaches it.
    pub fn finish(&mut self, machine: &Machine) -> Option<SpiByte> {
        let mut byte = self.in_transfer.take()?;
        let core = &machine.core;
        let outputs = core.get(DDRB);
        if outputs & SCK == 0 {
            machine.violation("SCK (PB5) is no output: the SPI's clock stays inside the chip");
            return None;
        }
        if outputs & MOSI == 0 {
            machine.violation("MOSI (PB3) is no output: the device reads ones");
            byte.mosi = 0xFF;
        }
        if core.get(SPCR) & DORD != 0 {
            byte.mosi = byte.mosi.reverse_bits();
        }
        Some(byte)
    }

    /// What the device shifted out meanwhile; sets SPIF.
    pub fn receive(&mut self, machine: &Machine, miso: u8) {
        let core = &machine.core;
        self.received = if core.get(SPCR) & DORD != 0 { miso.reverse_bits() } else { miso };
        core.set(SPDR, self.received);
        core.raise(Vector::SpiTransferComplete);
    }

    /// > [SPIF and WCOL are] cleared by first reading the SPI Status Register [...], and then
    /// > accessing the SPI Data Register. (section 19.5.2)
    fn clear_flags_if_seen(&mut self, machine: &Machine) {
        if std::mem::take(&mut self.status_seen) {
            machine.core.clear(Vector::SpiTransferComplete);
            machine.core.clear_bits(SPSR, SPIF | WCOL);
        }
    }
}
