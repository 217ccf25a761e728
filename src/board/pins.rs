//! The pins, by type: a pin belongs to whoever has its value, and there is one value of each.
//!
//! This is the place where a pin is chosen. Two choices are the chip's: OC1B and OC2B are where their timers are, and INT0 is on PD2.

use core::convert::Infallible;
use core::marker::PhantomData;

use avr_device::atmega168::{PORTB, PORTD};
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};

/// MCP2515 CS: D9.
pub type CanSelect = Output<B, 1>;
/// MCP2515 INT: D2.
pub type CanInterrupt = Input<D, 2>;
/// Servo: D10, OC1B, and the SPI's SS.
pub type ServoSignal = Output<B, 2>;
/// Button: D4.
#[cfg(feature = "button")]
pub type ButtonSignal = Input<D, 4>;

/// MOSI and SCK: D11 and D13. The SPI has them.
const MOSI: u8 = 3;
const SCK: u8 = 5;
/// TXD: D1. It idles high until the UART has it.
const TXD: u8 = 1;
/// Light: D3, OC2B. Timer2 has it.
const LIGHT: u8 = 3;
/// Button: D4. Pulled up whether the build has the feature or not.
const BUTTON: u8 = 4;

/// Port B.
pub struct B;
/// Port D.
pub struct D;

/// The registers of a port.
pub trait Port {
    /// Makes a bit of PORTx 1 or 0.
    ///
    /// # Safety
    ///
    /// The bit belongs to the caller.
    unsafe fn set(bit: u8, is_high: bool);
    /// A bit of PINx.
    fn is_high(bit: u8) -> bool;
}

macro_rules! port {
    ($port:ident, $registers:ident, $portx:ident, $pinx:ident) => {
        impl Port for $port {
            #[inline(always)]
            unsafe fn set(bit: u8, is_high: bool) {
                // Safety: `Pins::new` has consumed the port. The bit belongs to the caller, and with a constant bit this is one `sbi` or
                // `cbi`, so no interrupt can come between reading and writing the other bits.
                let registers = unsafe { $registers::steal() };
                registers.$portx().modify(|r, w| {
                    let bits = if is_high { r.bits() | 1 << bit } else { r.bits() & !(1 << bit) };
                    // Safety: PORTx takes any value.
                    unsafe { w.bits(bits) }
                });
            }

            #[inline(always)]
            fn is_high(bit: u8) -> bool {
                // Safety: reading PINx has no effect, whoever owns the port.
                unsafe { $registers::steal() }.$pinx().read().bits() & 1 << bit != 0
            }
        }
    };
}

port!(B, PORTB, portb, pinb);
port!(D, PORTD, portd, pind);

/// A pin that is driven.
pub struct Output<P, const BIT: u8>(PhantomData<P>);

/// A pin that is read, with its pull-up.
pub struct Input<P, const BIT: u8>(PhantomData<P>);

impl<P, const BIT: u8> Output<P, BIT> {
    /// The pin, without its [`Pins`].
    ///
    /// # Safety
    ///
    /// There is no other value of this pin, and it is not used before [`Pins::new`].
    pub const unsafe fn steal() -> Self {
        Self(PhantomData)
    }
}

impl<P, const BIT: u8> Input<P, BIT> {
    /// The pin. Reading has no effect, so there may be several values of it.
    pub const fn new() -> Self {
        Self(PhantomData)
    }
}

impl<P: Port, const BIT: u8> Output<P, BIT> {
    /// The level of the pin, whoever drives it.
    #[inline(always)]
    pub fn is_driven_high(&self) -> bool {
        P::is_high(BIT)
    }
}

impl<P: Port, const BIT: u8> Input<P, BIT> {
    /// The level of the pin.
    #[inline(always)]
    pub fn is_pulled_low(&self) -> bool {
        !P::is_high(BIT)
    }
}

impl<P, const BIT: u8> ErrorType for Output<P, BIT> {
    type Error = Infallible;
}

impl<P: Port, const BIT: u8> OutputPin for Output<P, BIT> {
    #[inline(always)]
    fn set_low(&mut self) -> Result<(), Infallible> {
        // Safety: this value is the only one of its pin.
        unsafe { P::set(BIT, false) };
        Ok(())
    }

    #[inline(always)]
    fn set_high(&mut self) -> Result<(), Infallible> {
        // Safety: this value is the only one of its pin.
        unsafe { P::set(BIT, true) };
        Ok(())
    }
}

impl<P, const BIT: u8> ErrorType for Input<P, BIT> {
    type Error = Infallible;
}

impl<P: Port, const BIT: u8> InputPin for Input<P, BIT> {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(!self.is_pulled_low())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(self.is_pulled_low())
    }
}

/// The pins that have no owner yet.
pub struct Pins {
    /// The servo's.
    pub servo: ServoSignal,
    /// The CAN controller's interrupt.
    pub can_interrupt: CanInterrupt,
    /// The button's.
    #[cfg(feature = "button")]
    pub button: ButtonSignal,
}

impl Pins {
    /// Sets up both ports, in full.
    pub fn new(portb: PORTB, portd: PORTD) -> Self {
        let select = bit::<CanSelect>();
        // CS is high before it becomes an output, the servo low. MISO is an input.
        // INT is pulled up, so that a shield that is not there asks for nothing.
        // Safety: PORTx and DDRx take any value.
        unsafe {
            portb.portb().write(|w| w.bits(select));
            portb.ddrb().write(|w| w.bits(select | bit::<ServoSignal>() | 1 << MOSI | 1 << SCK));
            portd.ddrd().write(|w| w.bits(1 << TXD | 1 << LIGHT));
            portd.portd().write(|w| w.bits(1 << TXD | bit::<CanInterrupt>() | 1 << BUTTON));
        }
        Self {
            servo: Output(PhantomData),
            can_interrupt: Input(PhantomData),
            #[cfg(feature = "button")]
            button: Input(PhantomData),
        }
    }
}

/// A pin's place in its port.
trait Bit {
    const BIT: u8;
}

impl<P, const BIT: u8> Bit for Output<P, BIT> {
    const BIT: u8 = BIT;
}

impl<P, const BIT: u8> Bit for Input<P, BIT> {
    const BIT: u8 = BIT;
}

/// A pin's bit in its port.
const fn bit<T: Bit>() -> u8 {
    1 << T::BIT
}
