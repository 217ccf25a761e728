//! From a reset to the decision: start the program, or stay in the loader.
//!
//! The loader starts only by a reset, and restarts by one, so that all registers have their initial values, here and in the program.

use core::arch::{asm, global_asm};

use node::handover::{CRC_START, REQUEST, REQUEST_LEN, RESTARTS, SHARED_RAM};

use crate::node_info::{MAINTENANCE, MODE};
use crate::registers::{MCUSR, WDCE, WDE, WDRF};
use crate::{crc, image};

/// First byte of the RAM that the loader and the program share.
const SHARED: u16 = match u16::from_str_radix(env!("RAM_END"), 10) {
    Ok(end) => end - SHARED_RAM,
    Err(_) => panic!("the RAM ends below 64 KB"),
};

/// So many watchdog restarts, with less than a minute of the program between them, keep the loader from starting the program.
const RESTARTS_ALLOWED: u8 = 3;

// The linker places `.vectors` first, so this is where a reset goes. Interrupts stay disabled, so there are no vectors. The compiler expects zero
// in r1. SPL is 0x3D, SPH is 0x3E.
global_asm!(
    ".section .vectors,\"ax\",@progbits",
    ".global start",
    "start:",
    "    clr r1",
    "    ldi r28, lo8({stack})",
    "    ldi r29, hi8({stack})",
    "    out 0x3E, r29",
    "    out 0x3D, r28",
    "    rjmp main",
    ".text",
    stack = const SHARED - 1,
);

/// Starts the program if it is to start. Returns true if the program has asked for an update, whose request is then in `request`.
#[inline(always)]
pub fn decide(request: *mut [u8; REQUEST_LEN]) -> bool {
    let flags = MCUSR.read();
    // WDRF keeps the watchdog on (datasheet 11.9.2), so it must be cleared first.
    MCUSR.write(0);
    set_watchdog(0);
    let restarts = shared(RESTARTS);
    // After a power-on the RAM is random, but other flags than WDRF are set, too.
    // SAFETY: `shared` returns a valid address, which nobody has a reference to.
    let count = if flags == WDRF { unsafe { *restarts }.wrapping_add(1) } else { 0 };
    // SAFETY: as above.
    unsafe { *restarts = count };
    let mut from = shared(REQUEST);
    let mut to = request.cast::<u8>();
    let mut len = REQUEST_LEN as u8;
    loop {
        // SAFETY: the loop reads the bytes of the request in the shared RAM, and writes those of the parameter.
        unsafe {
            *to = *from;
            // A request counts once.
            from.write_volatile(0);
            (to, from) = (to.add(1), from.add(1));
        }
        len -= 1;
        if len == 0 {
            break;
        }
    }
    // SAFETY: these are the bytes of the parameter.
    if unsafe { crc::of(CRC_START, request.cast(), REQUEST_LEN as u16) } == 0 {
        return true;
    }
    if count < RESTARTS_ALLOWED && image::is_valid() {
        // SAFETY: the program is complete and for this board. It does not return, and sets up stack and variables itself.
        unsafe { asm!("jmp 0", options(noreturn)) }
    }
    false
}

/// Lets the watchdog reset the chip in 16 ms. That is enough time to send an answer. Ends an update.
#[inline(never)]
pub fn restart_soon() {
    MODE.write(MAINTENANCE);
    // The reset makes this 0.
    // SAFETY: `shared` returns a valid address, which nobody has a reference to.
    unsafe { *shared(RESTARTS) = u8::MAX };
    set_watchdog(WDE);
}

/// Writes WDTCSR. WDE changes only within four cycles after WDCE is set (datasheet 11.8.2).
#[inline(always)]
fn set_watchdog(value: u8) {
    // SAFETY: the block writes only WDTCSR, at 0x60.
    unsafe {
        asm!("wdr", "sts 0x60, {change}", "sts 0x60, {value}", change = in(reg) WDCE | WDE, value = in(reg) value,
            options(nostack, preserves_flags));
    }
}

/// The address of a byte of the shared RAM.
#[inline(always)]
fn shared(offset: u16) -> *mut u8 {
    core::ptr::with_exposed_provenance_mut(usize::from(SHARED + offset))
}
