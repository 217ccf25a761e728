//! The chip: its registers, its crystal, and how a function becomes the handler of an interrupt.

#[cfg(chip = "atmega168")]
pub use avr_device::atmega168::*;
#[cfg(chip = "atmega328p")]
pub use avr_device::atmega328p::*;

/// Crystal of the Arduino, in hertz. The setup of Timer0, Timer1, the ADC and the UART depends on
/// it.
pub const CLOCK_HZ: u32 = 16_000_000;

/// Makes a function the handler of an interrupt. `avr_device` wants the name of the chip.
macro_rules! interrupt {
    ($name:ident $body:block) => {
        #[cfg_attr(chip = "atmega168", avr_device::interrupt(atmega168))]
        #[cfg_attr(chip = "atmega328p", avr_device::interrupt(atmega328p))]
        fn $name() $body
    };
}

pub(super) use interrupt;
