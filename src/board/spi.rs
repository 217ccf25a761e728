//! The SPI and the pins of the MCP2515.

use core::convert::Infallible;

use avr_device::atmega168::{PORTB, PORTD, SPI};
use embedded_hal::digital::{self, InputPin};
use embedded_hal::spi::{self, Operation, SpiDevice};

/// The SPI in mode 0,0 at 8 MHz (the MCP2515 takes 10), with the MCP2515 on it alone.
pub struct CanSpi {
    spi: SPI,
    portb: PORTB,
}

impl CanSpi {
    pub(super) fn new(spi: SPI, portb: PORTB) -> Self {
        // CS high before it becomes an output, and SS (the servo's pin) low. MISO is an input.
        portb.portb().write(|w| w.pb1().set_bit());
        portb.ddrb().write(|w| w.pb1().set_bit().pb2().set_bit().pb3().set_bit().pb5().set_bit());
        spi.spcr().write(|w| w.spe().set_bit().mstr().set_bit());
        spi.spsr().write(|w| w.spi2x().set_bit());
        Self { spi, portb }
    }

    #[inline(always)]
    fn begin(&mut self, byte: u8) {
        self.spi.spdr().write(|w| w.set(byte));
    }

    /// Sixteen cycles from `begin`, always: the master makes its own clock.
    #[inline(always)]
    fn wait(&mut self) {
        while self.spi.spsr().read().spif().bit_is_clear() {}
    }

    #[inline(always)]
    fn received(&mut self) -> u8 {
        self.spi.spdr().read().bits()
    }

    #[inline(always)]
    fn exchange(&mut self, byte: u8) -> u8 {
        self.begin(byte);
        self.wait();
        self.received()
    }

    #[inline(always)]
    fn select(&mut self) {
        self.portb.portb().modify(|_, w| w.pb1().clear_bit());
    }

    #[inline(always)]
    fn deselect(&mut self) {
        self.portb.portb().modify(|_, w| w.pb1().set_bit());
    }
}

impl spi::ErrorType for CanSpi {
    type Error = Infallible;
}

impl SpiDevice for CanSpi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        self.select();
        for operation in operations {
            match operation {
                Operation::Read(buffer) => buffer.iter_mut().for_each(|byte| *byte = self.exchange(0)),
                Operation::Write(bytes) => bytes.iter().for_each(|&byte| _ = self.exchange(byte)),
                Operation::TransferInPlace(buffer) => {
                    buffer.iter_mut().for_each(|byte| *byte = self.exchange(*byte));
                }
                Operation::Transfer(read, write) => {
                    let longest = read.len().max(write.len());
                    for n in 0..longest {
                        let byte = self.exchange(write.get(n).copied().unwrap_or(0));
                        if let Some(slot) = read.get_mut(n) {
                            *slot = byte;
                        }
                    }
                }
                Operation::DelayNs(ns) => {
                    // Never shorter than asked for; four cycles a turn.
                    for _ in 0..=(*ns / 250) {
                        avr_device::asm::nop();
                    }
                }
            }
        }
        self.deselect();
        Ok(())
    }

    // The two that the driver uses, without the list of operations: 1.2 KB of flash less.
    // Each stores and fetches while the SPI shifts.
    #[inline(never)]
    fn transfer_in_place(&mut self, buffer: &mut [u8]) -> Result<(), Infallible> {
        self.select();
        let mut bytes = buffer.iter_mut();
        if let Some(mut current) = bytes.next() {
            self.begin(*current);
            for next in bytes {
                let to_send = *next;
                self.wait();
                let received = self.received();
                self.begin(to_send);
                *current = received;
                current = next;
            }
            self.wait();
            *current = self.received();
        }
        self.deselect();
        Ok(())
    }

    #[inline(never)]
    fn write(&mut self, bytes: &[u8]) -> Result<(), Infallible> {
        self.select();
        for &byte in bytes {
            self.exchange(byte);
        }
        self.deselect();
        Ok(())
    }
}

/// The INT pin.
pub struct CanInterrupt {
    portd: PORTD,
}

impl CanInterrupt {
    pub(super) fn new(portd: PORTD) -> Self {
        // Pulled up, so that a shield that is not there asks for nothing. D1 idles high until the UART has it.
        portd.ddrd().write(|w| w.pd1().set_bit());
        portd.portd().write(|w| w.pd1().set_bit().pd2().set_bit());
        Self { portd }
    }
}

impl digital::ErrorType for CanInterrupt {
    type Error = Infallible;
}

impl InputPin for CanInterrupt {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.portd.pind().read().pd2().bit_is_set())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(self.portd.pind().read().pd2().bit_is_clear())
    }
}
