//! The pins as types. Each output pin has one value, and the owner of the value owns the pin.
//!
//! This file assigns the pins. The chip fixes some of them: OC1B is on PB2, OC2B on PD3, and INT0 on PD2.

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

/// MOSI and SCK: D11 and D13. The SPI drives them.
const MOSI: u8 = 3;
const SCK: u8 = 5;
/// TXD: D1. The port drives it high until the UART takes it over.
const TXD: u8 = 1;
/// Light: D3, OC2B. Timer2 drives it.
const LIGHT: u8 = 3;
/// Button: D4. The pull-up is on even without the feature `button`.
const BUTTON: u8 = 4;

/// Port B.
pub struct B;
/// Port D.
pub struct D;

/// The registers of a port.
pub trait Port {
    /// Sets or clears a bit of PORTx.
    ///
    /// # Safety
    ///
    /// The caller must own the pin of this bit.
    unsafe fn set(bit: u8, is_high: bool);
    /// Returns true if the bit of PINx is 1.
    fn is_high(bit: u8) -> bool;
}

macro_rules! port {
    ($port:ident, $registers:ident, $portx:ident, $pinx:ident) => {
        impl Port for $port {
            #[inline(always)]
            unsafe fn set(bit: u8, is_high: bool) {
                // Safety: `Pins::new` has consumed the port, so only this module uses it, and the caller owns the pin. The bit is a constant, so
                // this is one `sbi` or `cbi`: no interrupt can come between reading and writing the other bits.
                let registers = unsafe { $registers::steal() };
                registers.$portx().modify(|r, w| {
                    let bits = if is_high { r.bits() | 1 << bit } else { r.bits() & !(1 << bit) };
                    // Safety: every value of PORTx is valid.
                    unsafe { w.bits(bits) }
                });
            }

            #[inline(always)]
            fn is_high(bit: u8) -> bool {
                // Safety: this only reads PINx, which has no side effect, so the owner of the port does not matter.
                unsafe { $registers::steal() }.$pinx().read().bits() & 1 << bit != 0
            }
        }
    };
}

port!(B, PORTB, portb, pinb);
port!(D, PORTD, portd, pind);

/// An output pin.
pub struct Output<P, const BIT: u8>(PhantomData<P>);

/// An input pin with its pull-up.
pub struct Input<P, const BIT: u8>(PhantomData<P>);

impl<P, const BIT: u8> Output<P, BIT> {
    /// Makes a value of the pin without [`Pins`].
    ///
    /// # Safety
    ///
    /// There must be no other value of this pin, and nothing may use it before [`Pins::new`].
    pub const unsafe fn steal() -> Self {
        Self(PhantomData)
    }
}

impl<P, const BIT: u8> Input<P, BIT> {
    /// Makes a value of the pin. Reading has no side effect, so there may be several values.
    pub const fn new() -> Self {
        Self(PhantomData)
    }
}

impl<P: Port, const BIT: u8> Output<P, BIT> {
    /// Returns true if the level of the pin is high, also when a timer drives it.
    #[inline(always)]
    pub fn is_driven_high(&self) -> bool {
        P::is_high(BIT)
    }
}

impl<P: Port, const BIT: u8> Input<P, BIT> {
    /// Returns true if the level of the pin is low.
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
        // Safety: there is one value of each output pin, and `&mut self` is that value, so the caller owns the pin.
        unsafe { P::set(BIT, false) };
        Ok(())
    }

    #[inline(always)]
    fn set_high(&mut self) -> Result<(), Infallible> {
        // Safety: `&mut self` is the one value of this output pin, so the caller owns the pin.
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

/// The pins that other modules take.
pub struct Pins {
    /// The servo's pin.
    pub servo: ServoSignal,
    /// The CAN controller's INT pin.
    pub can_interrupt: CanInterrupt,
    /// The button's pin.
    #[cfg(feature = "button")]
    pub button: ButtonSignal,
}

impl Pins {
    /// Sets up both ports, all bits.
    pub fn new(portb: PORTB, portd: PORTD) -> Self {
        let select = bit::<CanSelect>();
        // CS is high and the servo's pin low before they become outputs. MISO is an input. INT has a pull-up, so that without a shield it stays
        // high and triggers nothing.
        // Safety: every value of PORTx and DDRx is valid.
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

/// The number of a pin in its port.
trait Bit {
    const BIT: u8;
}

impl<P, const BIT: u8> Bit for Output<P, BIT> {
    const BIT: u8 = BIT;
}

impl<P, const BIT: u8> Bit for Input<P, BIT> {
    const BIT: u8 = BIT;
}

/// The bit mask of a pin in its port.
const fn bit<T: Bit>() -> u8 {
    1 << T::BIT
}
