//! From a reset to the decision: start the program, or stay in the loader.
//!
//! The loader starts only by a reset, and restarts by one, so that all registers have their initial
//! values, here and in the program.

use core::arch::{asm, global_asm};

use firmware::handover::{CRC_START, REQUEST_LEN};
use firmware::tables::condition::ResetCause;

use crate::clock::{Timeout, set_watchdog};
use crate::node_info;
use crate::registers::idle::GPIOR0;
use crate::registers::{EXTRF, MCUSR, WDRF};
use crate::variables::{ADDRESS, ADDRESS_IN_Y, REQUEST_END, RESTART_COUNT, request};
use crate::{crc, image, serial};

/// So many watchdog restarts, with less than a minute of the program between them, keep the loader
/// from starting the program.
const RESTARTS_ALLOWED: u8 = 3;

// The linker places `.vectors` first, so this is where a reset goes. Interrupts stay disabled, so
// there are no vectors. The compiler expects zero in r1. SPL is 0x3D, SPH is 0x3E. `variables.rs`
// has what Y is for.
global_asm!(
    ".section .vectors,\"ax\",@progbits",
    ".global start",
    "start:",
    "    clr r1",
    "    ldi r28, lo8({stack})",
    "    ldi r29, hi8({stack})",
    "    out 0x3E, r29",
    "    out 0x3D, r28",
    "    subi r28, lo8({stack} - {y})",
    "    sbci r29, hi8({stack} - {y})",
    "    rjmp main",
    ".text",
    stack = const ADDRESS - 1,
    y = const ADDRESS_IN_Y,
);

/// GPIOR0 as the program reads it (src/board/guard.rs): the loader restarted the chip at the end of
/// an update or an upload, or the program hung.
const RESTARTED_FOR_UPDATE: u8 = 0xA0 | ResetCause::ASKED_FOR.0;
const HUNG: u8 = 0xA0 | ResetCause::WATCHDOG.0;

/// Starts the program if it is to start. Returns true if the program has asked for an update, whose
/// request is in its place.
#[inline(always)]
pub fn decide() -> bool {
    let flags = MCUSR.read();
    // WDRF keeps the watchdog on (datasheet 11.9.2), so it must be cleared first. The program tells
    // the others, and clears them.
    MCUSR.write(flags & !WDRF);
    // After a power-on the RAM is random, but other flags than WDRF are set, too.
    let count = if flags == WDRF { RESTART_COUNT.read().wrapping_add(1) } else { 0 };
    set_watchdog(Timeout::Never);
    RESTART_COUNT.write(count);
    // A serial port resets the chip by its pin alone. A power-on may set the same flag, and is to
    // start the program at once, as is the watchdog that ends an upload.
    if flags == EXTRF {
        serial::serve();
    }
    if image::is_valid() {
        node_info::take_version();
    } else {
        // So that it does not start. It would have cleared the flags, so the loader does: the next
        // reset has others.
        RESTART_COUNT.write(RESTARTS_ALLOWED);
        MCUSR.write(0);
    }
    // SAFETY: these are the bytes of the request.
    if unsafe { crc::of(CRC_START, request(), REQUEST_LEN as u16) } == 0 {
        // It counts once.
        REQUEST_END.write(REQUEST_END.read() ^ 1);
        return true;
    }
    if RESTART_COUNT.read() < RESTARTS_ALLOWED {
        // After a reset by the watchdog no flag is left, and the program tells this cause: that of
        // `restart` in src/board/guard.rs.
        GPIOR0.write(if count == 0 { RESTARTED_FOR_UPDATE } else { HUNG });
        // SAFETY: the program is complete and for this board. It does not return, and sets up stack
        // and variables itself.
        unsafe { asm!("jmp 0", options(noreturn)) }
    }
    false
}

/// Lets the watchdog reset the chip, and waits for that. Ends an update.
///
/// The node says nothing more: whether it is updated is known after the reset.
#[expect(clippy::empty_loop, reason = "the watchdog ends it")]
#[inline(never)]
pub fn restart() -> ! {
    set_watchdog(Timeout::Soon);
    loop {}
}
