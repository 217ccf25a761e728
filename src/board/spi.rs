//! The SPI bus of the MCP2515.

use core::convert::Infallible;

use super::chip::{SPI, steal};
use embedded_hal::spi::{self, SpiBus};

/// The SPI in mode 0,0 at 8 MHz. The MCP2515 allows 10 MHz.
pub struct CanSpi(());

impl CanSpi {
    /// Makes the value before the SPI is set up, so that the driver that owns it can be a static of
    /// zero bytes.
    ///
    /// # Safety
    ///
    /// There must be no other value of this type, and nothing may use it before
    /// [`set_up`](Self::set_up).
    pub const unsafe fn steal() -> Self {
        Self(())
    }

    /// Sets up the SPI. SS must be an output before. Consumes the registers: from here on only the
    /// driver uses them.
    pub fn set_up(spi: SPI) {
        spi.spcr.write(|w| w.spe().set_bit().mstr().set_bit());
        // A restart of the program may have cut a byte. The read, with the first access to SPDR,
        // clears the flag of that byte.
        _ = spi.spsr.read();
        spi.spsr.write(|w| w.spi2x().set_bit());
    }

    fn spi(&self) -> SPI {
        // Safety: `set_up` has consumed the registers, and `steal` requires that there is no other
        // value of this type. So nothing else uses them.
        unsafe { steal::<SPI>() }
    }

    fn begin(&mut self, byte: u8) {
        self.spi().spdr.write(|w| w.bits(byte));
    }

    /// Waits for the end of the byte, and returns the received byte. The wait always ends 16 cycles
    /// after `begin`, because the master makes the clock.
    #[inline(always)]
    fn finish(&mut self) -> u8 {
        while self.spi().spsr.read().spif().bit_is_clear() {}
        self.spi().spdr.read().bits()
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
    /// Reads the bytes. Stores each byte while the SPI shifts the next one.
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
        // The driver exchanges one byte at a time, which needs no loop.
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
