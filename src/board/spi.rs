//! The SPI and the pins of the MCP2515.

use core::convert::Infallible;

use avr_device::atmega168::{PORTB, PORTD, SPI};
use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::spi::{self, SpiBus};

/// The SPI in mode 0,0 at 8 MHz (the MCP2515 takes 10).
///
/// This and the two pins are there before the board is set up, so that the driver that has them can be a static that begins as
/// zeros. They are good for something once [`Board::new`](super::Board::new) has been called.
pub struct CanSpi(());

impl CanSpi {
    /// To be made once.
    pub const fn new() -> Self {
        Self(())
    }

    pub(super) fn set_up(spi: &SPI) {
        spi.spcr().write(|w| w.spe().set_bit().mstr().set_bit());
        spi.spsr().write(|w| w.spi2x().set_bit());
    }

    #[inline(always)]
    fn spi(&self) -> SPI {
        // Safety: nobody else uses the SPI after its set-up.
        unsafe { SPI::steal() }
    }

    #[inline(always)]
    fn begin(&mut self, byte: u8) {
        self.spi().spdr().write(|w| w.set(byte));
    }

    /// Sixteen cycles from `begin`, always: the master makes its own clock.
    #[inline(always)]
    fn finish(&mut self) -> u8 {
        while self.spi().spsr().read().spif().bit_is_clear() {}
        self.spi().spdr().read().bits()
    }

    #[inline(always)]
    fn exchange(&mut self, byte: u8) -> u8 {
        self.begin(byte);
        self.finish()
    }
}

impl spi::ErrorType for CanSpi {
    type Error = Infallible;
}

impl SpiBus for CanSpi {
    /// Stores each byte while the SPI shifts the next.
    #[inline(never)]
    fn read(&mut self, words: &mut [u8]) -> Result<(), Infallible> {
        let Some((last, others)) = words.split_last_mut() else { return Ok(()) };
        self.begin(0);
        for word in others {
            let received = self.finish();
            self.begin(0);
            *word = received;
        }
        *last = self.finish();
        Ok(())
    }

    #[inline(never)]
    fn write(&mut self, words: &[u8]) -> Result<(), Infallible> {
        for &word in words {
            self.exchange(word);
        }
        Ok(())
    }

    fn transfer(&mut self, read: &mut [u8], write: &[u8]) -> Result<(), Infallible> {
        for n in 0..read.len().max(write.len()) {
            let word = self.exchange(write.get(n).copied().unwrap_or(0));
            if let Some(slot) = read.get_mut(n) {
                *slot = word;
            }
        }
        Ok(())
    }

    #[inline(always)]
    fn transfer_in_place(&mut self, words: &mut [u8]) -> Result<(), Infallible> {
        // One byte is what the driver exchanges, and needs no loop.
        match words {
            [word] => *word = self.exchange(*word),
            words => words.iter_mut().for_each(|word| *word = self.exchange(*word)),
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// The CS pin.
pub struct CanSelect(());

impl CanSelect {
    /// See [`CanSpi`].
    pub const fn new() -> Self {
        Self(())
    }

    #[inline(always)]
    fn portb(&self) -> PORTB {
        // Safety: nobody else writes to this port after its set-up.
        unsafe { PORTB::steal() }
    }

    pub(super) fn set_up(portb: &PORTB) {
        // CS high before it becomes an output, and SS (the servo's pin) low. MISO is an input.
        portb.portb().write(|w| w.pb1().set_bit());
        portb.ddrb().write(|w| w.pb1().set_bit().pb2().set_bit().pb3().set_bit().pb5().set_bit());
    }
}

impl digital::ErrorType for CanSelect {
    type Error = Infallible;
}

impl OutputPin for CanSelect {
    #[inline(always)]
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.portb().portb().modify(|_, w| w.pb1().clear_bit());
        Ok(())
    }

    #[inline(always)]
    fn set_high(&mut self) -> Result<(), Infallible> {
        self.portb().portb().modify(|_, w| w.pb1().set_bit());
        Ok(())
    }
}

/// The INT pin.
pub struct CanInterrupt(());

impl CanInterrupt {
    /// See [`CanSpi`].
    pub const fn new() -> Self {
        Self(())
    }

    #[inline(always)]
    fn portd(&self) -> PORTD {
        // Safety: the pin is only read.
        unsafe { PORTD::steal() }
    }

    /// Whether the pin is low.
    #[inline(always)]
    pub fn is_low_now() -> bool {
        // Safety: the pin is only read.
        unsafe { PORTD::steal() }.pind().read().pd2().bit_is_clear()
    }

    pub(super) fn set_up(portd: &PORTD) {
        // The whole port: D1 idles high until the UART has it, D3 is the light, D4 the button. The INT pin is pulled up, so
        // that a shield that is not there asks for nothing.
        portd.ddrd().write(|w| w.pd1().set_bit().pd3().set_bit());
        portd.portd().write(|w| w.pd1().set_bit().pd2().set_bit().pd4().set_bit());
    }
}

impl digital::ErrorType for CanInterrupt {
    type Error = Infallible;
}

impl InputPin for CanInterrupt {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.portd().pind().read().pd2().bit_is_set())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(self.portd().pind().read().pd2().bit_is_clear())
    }
}
