//! The bootloader of `boot/`, and the end of the RAM, which the program shares with it (see
//! [`firmware::handover`]).

use core::arch::asm;

use super::chip::{TC1, steal};
use super::pins::ServoSignal;
use super::timer1;

use firmware::handover::{REQUEST, REQUEST_LEN, RESTARTS};

unsafe extern "C" {
    /// The last byte of the stack, from the linker (build.rs). The shared RAM follows.
    static __stack: u8;
}

/// Restarts by the watchdog within a minute that lead to the bootloader.
const RESTARTS_ALLOWED: u8 = 3;

/// Returns the address of a byte of the shared RAM.
fn shared(offset: u16) -> *mut u8 {
    (&raw const __stack).cast_mut().wrapping_add(1 + usize::from(offset))
}

/// True if the boot section begins as the loader of `boot/` does, with CLR r1. Other bootloaders
/// begin with a jump, or are shorter, so that the boot section begins with erased flash.
pub fn is_there() -> bool {
    const CLR_R1: u16 = 0x2411;
    const BOOT_SECTION: u16 = match u16::from_str_radix(env!("NODE_BOOT_SECTION"), 10) {
        Ok(address) => address,
        Err(_) => panic!("the boot section is in the first 64 KB"),
    };
    let word: u16;
    // Safety: LPM only reads flash and changes no memory, whatever the address.
    unsafe {
        asm!("lpm {0:l}, Z+", "lpm {0:h}, Z", out(reg_pair) word, inout("Z") BOOT_SECTION => _,
            options(pure, readonly, nostack, preserves_flags));
    }
    word == CLR_R1
}

/// Counts a restart by the watchdog. Returns true if there were too many within a minute.
pub fn count_restart() -> bool {
    let restarts = shared(RESTARTS);
    // Safety: the byte is behind the stack, so it is no variable, and there is no reference to it.
    unsafe {
        let count = restarts.read_volatile().wrapping_add(1);
        restarts.write_volatile(count);
        count >= RESTARTS_ALLOWED
    }
}

/// Forgets the restarts: the program has run for a minute.
pub fn forget_restarts() {
    // Safety: as in `count_restart`.
    unsafe { shared(RESTARTS).write_volatile(0) };
}

/// Resets the chip, so that the bootloader does the update of the request.
pub fn enter(request: Option<&[u8; REQUEST_LEN]>) -> ! {
    avr_device::interrupt::disable();
    super::outputs::finish();
    // Until the reset the timer makes no other pulse, which that would cut.
    // Safety: interrupts are disabled and this function does not return, so nobody else uses the
    // timer or the pin any more.
    let (tc1, signal) = unsafe { (steal::<TC1>(), ServoSignal::steal()) };
    timer1::stop(&tc1, &signal);
    if let Some(request) = request {
        for (n, byte) in request.iter().enumerate() {
            // Safety: these bytes are behind the stack, so they are no variables, and there is no
            // reference to them.
            unsafe { shared(REQUEST).wrapping_add(n).write_volatile(*byte) };
        }
    }
    // WDCE | WDE, then within four cycles WDE alone: a reset within 16 ms, and no interrupt.
    // Safety: the block writes only WDTCSR, in the sequence that the datasheet requires. Interrupts
    // are disabled.
    unsafe {
        asm!("sts 0x60, {change}", "sts 0x60, {value}", change = in(reg) 0x18u8,
            value = in(reg) 0x08u8, options(nostack, preserves_flags));
    }
    #[allow(clippy::empty_loop, reason = "the watchdog ends it")]
    loop {}
}
