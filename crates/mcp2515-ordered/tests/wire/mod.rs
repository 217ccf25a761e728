//! The SPI and the pins of a simulated chip, as the driver uses them.

use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;

use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::spi::{self, Operation, SpiBus, SpiDevice};

/// The other end of the wires.
pub trait Peripheral {
    /// Exchanges bytes on the SPI.
    fn exchange(&mut self, words: &mut [u8]);

    /// CS falls.
    fn select(&mut self);

    /// CS rises.
    fn deselect(&mut self);

    /// The level of INT.
    fn is_int_high(&self) -> bool;
}

/// The wires to a peripheral. The driver gets a clone for the SPI and for each pin.
pub struct Wire<P>(pub Rc<RefCell<P>>);

impl<P> Clone for Wire<P> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<P> spi::ErrorType for Wire<P> {
    type Error = Infallible;
}

impl<P> digital::ErrorType for Wire<P> {
    type Error = Infallible;
}

impl<P: Peripheral> SpiBus for Wire<P> {
    fn read(&mut self, words: &mut [u8]) -> Result<(), Infallible> {
        words.fill(0);
        self.transfer_in_place(words)
    }

    fn write(&mut self, words: &[u8]) -> Result<(), Infallible> {
        self.transfer_in_place(&mut words.to_vec())
    }

    fn transfer(&mut self, _read: &mut [u8], _write: &[u8]) -> Result<(), Infallible> {
        unimplemented!("the driver does not use it")
    }

    fn transfer_in_place(&mut self, words: &mut [u8]) -> Result<(), Infallible> {
        self.0.borrow_mut().exchange(words);
        Ok(())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl<P: Peripheral> OutputPin for Wire<P> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().select();
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().deselect();
        Ok(())
    }
}

impl<P: Peripheral> InputPin for Wire<P> {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.borrow().is_int_high())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

/// The peripheral as one of several devices on its SPI.
pub struct Device<P>(pub Wire<P>);

impl<P> spi::ErrorType for Device<P> {
    type Error = Infallible;
}

impl<P: Peripheral> SpiDevice for Device<P> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        self.0.set_low()?;
        for operation in operations {
            match operation {
                Operation::TransferInPlace(words) => self.0.transfer_in_place(words)?,
                _ => unimplemented!("the driver does not use it"),
            }
        }
        self.0.set_high()
    }
}
