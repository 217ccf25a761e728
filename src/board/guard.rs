//! Restarts the program when it goes wrong, and remembers why.
//!
//! The watchdog interrupts when the main loop has not been round for 250 ms, and the program restarts by a jump to its
//! beginning, with the cause in GPIOR0. It does not leave this to the watchdog's own reset, because the Diecimila's bootloader
//! leaves the watchdog running after that: it would be reset every 16 ms for ever, in the middle of waiting for an upload.
//! The reset is only left for a restart that hangs in turn. Nothing hangs with interrupts off: once they are on, they are off only where
//! a handler begins and ends, while Timer0's adds one to a byte, and for seven cycles where a byte of the EEPROM is begun.
//!
//! A panic, an interrupt without a handler and a collision of the stack with the variables restart the same way.

use core::arch::{asm, global_asm};
use core::panic::PanicInfo;

use avr_device::atmega168::CPU;

use node::node::condition::ResetCause;

// Before anything else runs: save and clear the reset flags, stop the watchdog (which may still run from before, and must be
// written within four cycles), and paint the RAM that the stack can grow into. r1 is zero and the stack unused at .init3.
//
// GPIOR1 = 0x2A, MCUSR = 0x34, WDTCSR = 0x60, RAM ends at 0x4FF.
global_asm!(
    ".section .init3,\"ax\",@progbits",
    "    wdr",
    "    in   r24, 0x34",
    "    out  0x2A, r24",
    "    out  0x34, r1",
    "    ldi  r24, 0x18",
    "    sts  0x60, r24",
    "    sts  0x60, r1",
    "    ldi  r30, lo8(__heap_start)",
    "    ldi  r31, hi8(__heap_start)",
    "    ldi  r24, {paint}",
    "    ldi  r25, 0x05",
    "1:  st   Z+, r24",
    "    cpi  r30, 0x00",
    "    cpc  r31, r25",
    "    brlo 1b",
    ".text",
    paint = const PAINT,
);

/// What unused RAM is filled with at start.
const PAINT: u8 = 0xC5;

/// Marks GPIOR0 as written by [`restart`].
const RESTARTED: u8 = 0xA0;

unsafe extern "C" {
    /// The first byte after the variables, from the linker.
    static __heap_start: [u8; 2];
}

/// Why the program started. To be called once.
pub fn reset_cause(cpu: &CPU) -> ResetCause {
    let software = cpu.gpior0().read().bits();
    cpu.gpior0().write(|w| w.set(0));
    // The saved MCUSR: WDRF, BORF, EXTRF, PORF from bit 3 down. At power-on the others mean nothing.
    let flags = cpu.gpior1().read().bits();
    if flags & 0b0001 != 0 {
        ResetCause::POWER_ON
    } else if flags & 0b1000 != 0 {
        ResetCause::WATCHDOG
    } else if flags & 0b0100 != 0 {
        ResetCause::BROWN_OUT
    } else if flags & 0b0010 == 0 && software & 0xF0 == RESTARTED {
        ResetCause(software & 0x0F)
    } else {
        // Some bootloaders clear MCUSR.
        ResetCause::EXTERNAL
    }
}

/// Starts the watchdog and lets interrupts in.
pub fn start() {
    // Safety: writes only WDTCSR, in the sequence that the datasheet asks for, with interrupts off as they are from reset to
    // here: WDCE | WDE, then within four cycles WDIF (to clear it) | WDIE | WDE | WDP2
    // (250 ms).
    unsafe {
        asm!("wdr", "sts 0x60, {change}", "sts 0x60, {value}", change = in(reg) 0x18u8, value = in(reg) 0xCCu8,
            options(nostack, preserves_flags));
    }
    // Safety: all handlers are in place, and no critical section is open.
    unsafe { avr_device::interrupt::enable() };
}

/// To be called once in each turn of the main loop: it is alive.
#[inline(always)]
pub fn is_alive() {
    avr_device::asm::wdr();
}

/// To be called once a millisecond: the stack has kept clear of the variables, or the program starts over.
pub fn check_stack() {
    let floor = (&raw const __heap_start).cast::<u8>();
    // Safety: two bytes of RAM that nothing but the stack can write. Volatile, because that is not for the compiler to know.
    let [first, second] = unsafe { [floor.read_volatile(), floor.add(1).read_volatile()] };
    if first != PAINT || second != PAINT {
        restart(ResetCause::STACK_COLLISION);
    }
}

/// Starts the program over.
pub fn restart(cause: ResetCause) -> ! {
    // GPIOR0 = 0x1E.
    // Safety: nothing of the running program is used any more; its beginning sets up the stack and all variables anew, and
    // `Board::new` all registers.
    unsafe { asm!("cli", "out 0x1E, {cause}", "jmp 0", cause = in(reg) RESTARTED | cause.0, options(noreturn)) }
}

#[panic_handler]
fn panic(_info: &PanicInfo) -> ! {
    restart(ResetCause::PANIC)
}

#[avr_device::interrupt(atmega168)]
fn WDT() {
    restart(ResetCause::WATCHDOG)
}

/// avr-libc sends every interrupt here that has no handler.
// Safety: the name is avr-libc's, with this signature.
#[unsafe(no_mangle)]
extern "avr-interrupt" fn __vector_default() {
    restart(ResetCause::STRAY_INTERRUPT)
}
