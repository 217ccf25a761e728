//! The chip: its registers, its crystal, and how a function becomes the handler of an interrupt.

#[cfg(chip = "atmega168")]
pub use avr_device::atmega168::*;
#[cfg(chip = "atmega328p")]
pub use avr_device::atmega328p::*;

/// A value of a register block. `Peripherals` has all of them together, and a byte of RAM that says
/// so.
///
/// # Safety
/// `T` must be a register block. The caller argues that nobody else uses it at that time.
pub const unsafe fn steal<T>() -> T {
    const { assert!(size_of::<T>() == 0) };
    // Safety: a register block has no bytes, so each of its values is as good as another.
    unsafe { core::mem::zeroed() }
}

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
