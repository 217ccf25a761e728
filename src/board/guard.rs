//! Restarts the program after a fault, and keeps the cause.
//!
//! If the main loop completes no turn for 250 ms, the watchdog triggers its interrupt. The handler
//! stores the cause in GPIOR0 and jumps to the start of the program. The watchdog's own reset is
//! not used for this, because the Diecimila's bootloader leaves the watchdog running after it: the
//! watchdog would reset the bootloader every 16 ms for ever, while it waits for an upload. That
//! reset remains for a restart that hangs itself.
//!
//! The program cannot hang with interrupts disabled. After `start` they are disabled only at the
//! beginning and the end of a handler, while Timer0's handler increments a byte, and for seven
//! cycles where the write of an EEPROM byte starts.
//!
//! A panic, an interrupt without a handler, and a collision of the stack with the variables restart
//! the program in the same way.

use core::arch::{asm, global_asm};
use core::panic::PanicInfo;

use super::chip::CPU;
use firmware::tables::condition::ResetCause;

// Runs before everything else. Saves MCUSR in GPIOR1 and clears it. Stops the watchdog, which may
// still run; the second write to WDTCSR must follow within four cycles. Paints the RAM that the
// stack can grow into. At .init3 r1 is zero and the stack is unused.
//
// GPIOR1 = 0x2A, MCUSR = 0x34, WDTCSR = 0x60. avr-libc's `__stack` is the last byte of the RAM.
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
    "    ldi  r25, hi8(__stack + 1)",
    "1:  st   Z+, r24",
    "    cpi  r30, lo8(__stack + 1)",
    "    cpc  r31, r25",
    "    brlo 1b",
    ".text",
    paint = const PAINT,
);

/// The value of unused RAM after the start.
const PAINT: u8 = 0xC5;

/// Upper half of GPIOR0 after [`restart`]. The lower half is the cause.
const RESTARTED: u8 = 0xA0;

unsafe extern "C" {
    /// The first byte after the variables, from the linker.
    static __heap_start: [u8; 2];
}

/// Returns why the program started. Call it once: it clears GPIOR0.
pub fn reset_cause(cpu: &CPU) -> ResetCause {
    let software = cpu.gpior0.read().bits();
    cpu.gpior0.write(|w| w.bits(0));
    // The saved MCUSR: WDRF, BORF, EXTRF, PORF from bit 3 down. After a power-on the other flags
    // are undefined.
    let flags = cpu.gpior1.read().bits();
    if flags & 0b0001 != 0 {
        ResetCause::POWER_ON
    } else if flags & 0b1000 != 0 {
        ResetCause::WATCHDOG
    } else if flags & 0b0100 != 0 {
        ResetCause::BROWN_OUT
    } else if flags & 0b0010 == 0 && software & 0xF0 == RESTARTED {
        ResetCause(software & 0x0F)
    } else {
        // EXTRF, or no flag at all: some bootloaders clear MCUSR.
        ResetCause::EXTERNAL
    }
}

/// Starts the watchdog and enables interrupts.
pub fn start() {
    // WDCE | WDE, then within four cycles WDIF (to clear it) | WDIE | WDE | WDP2 (250 ms).
    // Safety: the block writes only WDTCSR, in the sequence that the datasheet requires. Interrupts
    // are disabled from the reset to here, so none comes in between.
    unsafe {
        asm!("wdr", "sts 0x60, {change}", "sts 0x60, {value}", change = in(reg) 0x18u8,
            value = in(reg) 0xCCu8, options(nostack, preserves_flags));
    }
    // Safety: `main` calls this once, after `Board::new` has set up all that the handlers use, and
    // outside every critical section.
    unsafe { avr_device::interrupt::enable() };
}

/// Resets the watchdog. Call it once in each turn of the main loop.
pub fn restart_watchdog() {
    avr_device::asm::wdr();
}

/// Restarts the program if the stack has reached the variables. Call it once a millisecond.
pub fn check_stack() {
    let floor = (&raw const __heap_start).cast::<u8>();
    // Safety: the linker places `__heap_start` after the variables, so these are two valid bytes of
    // RAM that only the stack can write. The read is volatile because the compiler does not see
    // the writes of the stack.
    let [first, second] = unsafe { [floor.read_volatile(), floor.add(1).read_volatile()] };
    if first != PAINT || second != PAINT {
        restart(ResetCause::STACK_COLLISION);
    }
}

/// Restarts the program, and stores the cause in GPIOR0.
#[inline(never)]
pub fn restart(cause: ResetCause) -> ! {
    avr_device::interrupt::disable();
    super::outputs::finish();
    // GPIOR0 = 0x1E.
    // Safety: the block does not return, so the running program uses nothing any more. The start
    // code sets up the stack and all variables again, and `Board::new` all registers.
    unsafe {
        asm!("cli", "out 0x1E, {cause}", "jmp 0", cause = in(reg) RESTARTED | cause.0,
            options(noreturn))
    }
}

#[panic_handler]
fn panic(_info: &PanicInfo) -> ! {
    restart(ResetCause::PANIC)
}

// The handler of the watchdog's interrupt, and the one that avr-libc calls for every interrupt
// without a handler. Neither returns, so they save no registers.
global_asm!(
    ".global __vector_6, __vector_default",
    "__vector_6:",
    "    clr  r1",
    "    jmp  {hung}",
    "__vector_default:",
    "    clr  r1",
    "    jmp  {stray}",
    hung = sym hung,
    stray = sym stray,
);

extern "C" fn hung() -> ! {
    // After the third restart within a minute, the bootloader waits for another program.
    if super::loader::is_there() && super::loader::count_restart() {
        super::loader::enter(None);
    }
    restart(ResetCause::WATCHDOG)
}

extern "C" fn stray() -> ! {
    restart(ResetCause::STRAY_INTERRUPT)
}
