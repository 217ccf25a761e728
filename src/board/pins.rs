//! The pins as types. Each output pin has one value, and the owner of the value owns the pin.
//!
//! [`firmware::hardware`] says which pins the board of this build has. The chip fixes some of them:
//! OC1A is on PB1, OC1B on PB2, OC2B on PD3, INT0 on PD2 and INT1 on PD3.

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use firmware::hardware::{BUTTON, CAN_INTERRUPT, CAN_SELECT, LIGHT, Pin, SERVO, SHAFT};

use super::chip::{PORTB, PORTC, PORTD, steal};

/// MCP2515 CS.
pub type CanSelect = Output<{ CAN_SELECT.port }, { CAN_SELECT.bit }>;
/// MCP2515 INT.
pub type CanInterrupt = Input<{ CAN_INTERRUPT.port }, { CAN_INTERRUPT.bit }>;
/// The servo's signal.
pub type ServoSignal = Output<{ SERVO.port }, { SERVO.bit }>;
/// The button.
pub type ButtonSignal = Input<{ BUTTON.port }, { BUTTON.bit }>;

/// The SPI's SS: D10. It must be an output, so that the SPI stays master.
const SS: Pin = Pin::named("D10");
/// The SPI drives these.
const MOSI: Pin = Pin::named("D11");
const SCK: Pin = Pin::named("D13");
/// The port drives TXD high until the UART takes it over.
const TXD: Pin = Pin::named("D1");

/// Pins that are outputs. Timer1 drives the servo's pin, Timer2 the light's.
const OUTPUTS: [Option<Pin>; 7] =
    [Some(CAN_SELECT), Some(SERVO), Some(SS), Some(MOSI), Some(SCK), Some(TXD), LIGHT];
/// Outputs that start high, and inputs with a pull-up. The pull-up of INT keeps it high without a
/// CAN board. The button's is on even without the feature `button`.
const HIGH: [Option<Pin>; 5] =
    [Some(CAN_SELECT), Some(TXD), Some(CAN_INTERRUPT), Some(BUTTON), SHAFT];

/// The bits of a port among `pins`.
const fn mask(pins: &[Option<Pin>], port: u8) -> u8 {
    let mut mask = 0;
    let mut n = 0;
    while n < pins.len() {
        match pins[n] {
            Some(pin) if pin.port == port => mask |= pin.mask(),
            _ => {}
        }
        n += 1;
    }
    mask
}

/// Sets or clears a bit of PORTx.
///
/// # Safety
///
/// The caller must own the pin of this bit. `PORT` and `BIT` must be constants of an [`Output`].
unsafe fn set<const PORT: u8, const BIT: u8>(is_high: bool) {
    macro_rules! write {
        ($registers:ident, $portx:ident) => {{
            // Safety: `Pins::new` has consumed the port, so only this module uses it, and the
            // caller owns the pin. The bit is a constant, so this is one `sbi` or `cbi`: no
            // interrupt can come between reading and writing the other bits.
            let registers = unsafe { steal::<$registers>() };
            registers.$portx.modify(|r, w| {
                let bits = if is_high { r.bits() | 1 << BIT } else { r.bits() & !(1 << BIT) };
                // Safety: every value of PORTx is valid.
                unsafe { w.bits(bits) }
            });
        }};
    }
    match PORT {
        b'B' => write!(PORTB, portb),
        b'C' => write!(PORTC, portc),
        _ => write!(PORTD, portd),
    }
}

/// Returns true if the bit of PINx is 1.
fn is_high<const PORT: u8, const BIT: u8>() -> bool {
    // Safety: this only reads PINx, which has no side effect, so the owner of the port does not
    // matter.
    let pins = unsafe {
        match PORT {
            b'B' => steal::<PORTB>().pinb.read().bits(),
            b'C' => steal::<PORTC>().pinc.read().bits(),
            _ => steal::<PORTD>().pind.read().bits(),
        }
    };
    pins & 1 << BIT != 0
}

/// An output pin.
pub struct Output<const PORT: u8, const BIT: u8>(());

/// An input pin with its pull-up.
pub struct Input<const PORT: u8, const BIT: u8>(());

impl<const PORT: u8, const BIT: u8> Output<PORT, BIT> {
    /// Makes a value of the pin without [`Pins`].
    ///
    /// # Safety
    ///
    /// There must be no other value of this pin, and nothing may use it before [`Pins::new`].
    pub const unsafe fn steal() -> Self {
        Self(())
    }
}

impl<const PORT: u8, const BIT: u8> Input<PORT, BIT> {
    /// Makes a value of the pin. Reading has no side effect, so there may be several values.
    pub const fn new() -> Self {
        Self(())
    }
}

impl<const PORT: u8, const BIT: u8> Output<PORT, BIT> {
    /// Returns true if the level of the pin is high, also when a timer drives it.
    pub fn is_driven_high(&self) -> bool {
        is_high::<PORT, BIT>()
    }
}

impl<const PORT: u8, const BIT: u8> Input<PORT, BIT> {
    /// Returns true if the level of the pin is low.
    pub fn is_pulled_low(&self) -> bool {
        !is_high::<PORT, BIT>()
    }
}

impl<const PORT: u8, const BIT: u8> ErrorType for Output<PORT, BIT> {
    type Error = Infallible;
}

impl<const PORT: u8, const BIT: u8> OutputPin for Output<PORT, BIT> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        // Safety: there is one value of each output pin, and `&mut self` is that value, so the
        // caller owns the pin.
        unsafe { set::<PORT, BIT>(false) };
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        // Safety: `&mut self` is the one value of this output pin, so the caller owns the pin.
        unsafe { set::<PORT, BIT>(true) };
        Ok(())
    }
}

impl<const PORT: u8, const BIT: u8> ErrorType for Input<PORT, BIT> {
    type Error = Infallible;
}

impl<const PORT: u8, const BIT: u8> InputPin for Input<PORT, BIT> {
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
    pub button: ButtonSignal,
}

impl Pins {
    /// Sets up all ports. Outputs get their level before they become outputs.
    pub fn new(portb: PORTB, portc: PORTC, portd: PORTD) -> Self {
        // Safety: every value of PORTx and DDRx is valid.
        unsafe {
            portb.portb.write(|w| w.bits(const { mask(&HIGH, b'B') }));
            portb.ddrb.write(|w| w.bits(const { mask(&OUTPUTS, b'B') }));
            // Only a wired CS can be on port C.
            if const { mask(&OUTPUTS, b'C') } != 0 {
                portc.portc.write(|w| w.bits(const { mask(&HIGH, b'C') }));
                portc.ddrc.write(|w| w.bits(const { mask(&OUTPUTS, b'C') }));
            }
            portd.portd.write(|w| w.bits(const { mask(&HIGH, b'D') }));
            portd.ddrd.write(|w| w.bits(const { mask(&OUTPUTS, b'D') }));
        }
        Self { servo: Output(()), can_interrupt: Input(()), button: Input(()) }
    }
}
