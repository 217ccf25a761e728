//! What differs between the chips, and what arduino-hal does not have.

use core::arch::asm;
use core::panic::PanicInfo;

#[cfg(feature = "diecimila")]
use avr_device::atmega168 as device;
#[cfg(feature = "uno")]
use avr_device::atmega328p as device;

use device::EXINT;

#[cfg_attr(feature = "diecimila", avr_device::interrupt(atmega168))]
#[cfg_attr(feature = "uno", avr_device::interrupt(atmega328p))]
fn INT0() {
    crate::frame_received();
}

#[cfg_attr(feature = "diecimila", avr_device::interrupt(atmega168))]
#[cfg_attr(feature = "uno", avr_device::interrupt(atmega328p))]
fn TIMER0_COMPA() {
    crate::millisecond_passed();
}

/// Enables the interrupt INT0 at the falling edge of D2. As numbers, because the ATmega168 of
/// `avr-device` has no names for these fields.
pub fn enable_int0(interrupts: &EXINT) {
    // SAFETY: EICRA and EIMSK have no values that are not allowed.
    interrupts.eicra().write(|w| unsafe { w.bits(0b10) });
    // SAFETY: as above.
    interrupts.eimsk().write(|w| unsafe { w.bits(1) });
}

/// Starts the program again. The reset of the watchdog would not do on a Diecimila: its bootloader
/// leaves the watchdog running, which resets the bootloader every 16 ms.
pub fn restart() -> ! {
    // SAFETY: the program begins at address 0. It initializes all variables, and the peripherals
    // that it uses.
    unsafe { asm!("cli", "jmp 0", options(noreturn)) }
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    restart()
}
