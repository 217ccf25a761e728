//! The SPI as a master (datasheet section 19), with one device on it.
//!
//! simavr restarts a transfer when the program writes SPDR during it; the chip, and this model,
//! ignore the write and set WCOL. The model clears SPIF and WCOL as section 19.5 says. The device
//! gets a byte only if SCK is an output. It reports the program's mistakes as violations. Not
//! modelled: slave mode, the phase of the SCK divider.

use std::cell::RefCell;

use super::base::{Base, Peripheral, Timer};
use super::chip::Chip;
use super::core::Vector;
use super::processor::{SpiByte, SpiDevice};
use super::regs::{CPHA, CPOL, DDRB, DORD, MSTR, SPCR, SPDR, SPE, SPI2X, SPIF, SPR, SPSR, WCOL};
use sim_base::Cycles;
use sim_base::Noise;

/// Expires at the end of a transfer.
const TIMER: Timer = Timer::Spi;

/// Pins of port B.
const SS: u8 = 1 << 2;
const MOSI: u8 = 1 << 3;
const SCK: u8 = 1 << 5;

/// The SPI and the device on it.
#[derive(Default)]
pub(super) struct Spi {
    master: RefCell<Master>,
    device: RefCell<Option<Box<dyn SpiDevice>>>,
}

impl Spi {
    /// Connects the device, in place of an earlier one.
    pub fn set_device(&self, device: Box<dyn SpiDevice>) {
        self.device.replace(Some(device));
    }

    /// Calls the device, which may drive pins.
    fn with_device<T>(&self, call: impl FnOnce(&mut dyn SpiDevice) -> T) -> Option<T> {
        let mut device = self.device.take()?;
        let result = call(&mut *device);
        self.device.replace(Some(device));
        Some(result)
    }
}

impl Peripheral for Spi {
    fn for_chip(_: Chip) -> Spi {
        Spi::default()
    }

    fn writes(&self) -> &'static [u16] {
        &[SPCR, SPSR, SPDR]
    }

    fn reads(&self) -> &'static [u16] {
        &[SPSR, SPDR]
    }

    fn timers(&self) -> &'static [Timer] {
        &[TIMER]
    }

    fn write(&self, base: &Base, address: u16, value: u8) {
        match address {
            SPDR => {
                let start = self.master.borrow_mut().write_data(base, value);
                if let Some(start) = start {
                    self.with_device(|device| device.begin_byte(start));
                }
            }
            SPSR => self.master.borrow_mut().write_status(base, value),
            _ => self.master.borrow_mut().write_control(base, value),
        }
    }

    fn read(&self, base: &Base, address: u16) -> u8 {
        match address {
            SPDR => self.master.borrow_mut().read_data(base),
            _ => self.master.borrow_mut().read_status(base),
        }
    }

    fn expire(&self, base: &Base, _: Timer, _: Cycles) {
        let byte = self.master.borrow_mut().finish(base);
        let miso = byte.and_then(|byte| self.with_device(|device| device.end_byte(&byte)));
        self.master.borrow_mut().receive(base, miso.unwrap_or(0xFF));
    }

    fn reset(&self, _: &Base, _: &mut Noise) {
        self.master.take();
    }
}

/// The SPI's registers and its transfer in progress.
#[derive(Debug, Default)]
struct Master {
    in_transfer: Option<SpiByte>,
    received: u8,
    /// True if the program has read SPSR with SPIF or WCOL set: the next access of SPDR clears
    /// both.
    status_seen: bool,
}

impl Master {
    /// Writes SPDR. Returns the start of the transfer, if one starts.
    fn write_data(&mut self, base: &Base, value: u8) -> Option<Cycles> {
        let core = &base.core;
        let control = core.get(SPCR);
        if control & SPE == 0 {
            base.report_violation("SPDR is written while the SPI is off");
            return None;
        }
        if control & MSTR == 0 {
            base.report_violation(
                "SPDR is written while the SPI is a slave, which is not modelled",
            );
            return None;
        }
        if self.in_transfer.is_some() {
            core.set_bits(SPSR, WCOL);
            base.report_violation("SPDR is written during a transfer: the byte is lost (WCOL)");
            return None;
        }
        self.clear_flags_if_seen(base);
        if core.get(DDRB) & SS == 0 {
            base.report_violation(
                "SS (PB2) is an input while the SPI is master: a low level there ends master mode",
            );
        }
        let divisor = [4, 16, 64, 128][usize::from(control & SPR)];
        let cycles_per_bit = if core.get(SPSR) & SPI2X != 0 { divisor / 2 } else { divisor };
        let start = base.now();
        let end = start + 8 * cycles_per_bit;
        let mode = (control & (CPOL | CPHA)) >> 2;
        self.in_transfer = Some(SpiByte { mosi: value, start, end, cycles_per_bit, mode });
        base.schedule(TIMER, end);
        Some(start)
    }

    /// Reads SPDR.
    fn read_data(&mut self, base: &Base) -> u8 {
        self.clear_flags_if_seen(base);
        self.received
    }

    /// Reads SPSR.
    fn read_status(&mut self, base: &Base) -> u8 {
        let status = base.core.get(SPSR);
        self.status_seen = status & (SPIF | WCOL) != 0;
        status
    }

    /// Writes SPSR. Only SPI2X can be written.
    fn write_status(&mut self, base: &Base, value: u8) {
        let status = base.core.get(SPSR);
        base.core.set(SPSR, status & !SPI2X | value & SPI2X);
    }

    /// Writes SPCR. Switching the SPI off ends a transfer.
    fn write_control(&mut self, base: &Base, value: u8) {
        base.core.set(SPCR, value);
        if value & SPE == 0 && self.in_transfer.take().is_some() {
            base.unschedule(TIMER);
            base.report_violation("the SPI is switched off during a transfer");
        }
    }

    /// Ends the transfer. Returns the byte for the device; `None` if no clock reaches it.
    fn finish(&mut self, base: &Base) -> Option<SpiByte> {
        let mut byte = self.in_transfer.take()?;
        let core = &base.core;
        let outputs = core.get(DDRB);
        if outputs & SCK == 0 {
            base.report_violation(
                "SCK (PB5) is not an output: the SPI's clock does not leave the chip",
            );
            return None;
        }
        if outputs & MOSI == 0 {
            base.report_violation("MOSI (PB3) is not an output: the device reads ones");
            byte.mosi = 0xFF;
        }
        if core.get(SPCR) & DORD != 0 {
            byte.mosi = byte.mosi.reverse_bits();
        }
        Some(byte)
    }

    /// Takes the byte that the device has shifted out, and sets SPIF.
    fn receive(&mut self, base: &Base, miso: u8) {
        let core = &base.core;
        self.received = if core.get(SPCR) & DORD != 0 { miso.reverse_bits() } else { miso };
        core.set(SPDR, self.received);
        core.raise(Vector::SpiTransferComplete);
    }

    /// > [SPIF and WCOL are] cleared by first reading the SPI Status Register [...], and then
    /// > accessing the SPI Data Register. (section 19.5.2)
    fn clear_flags_if_seen(&mut self, base: &Base) {
        if std::mem::take(&mut self.status_seen) {
            base.core.clear(Vector::SpiTransferComplete);
            base.core.clear_bits(SPSR, SPIF | WCOL);
        }
    }
}
