//! The firmware: the program on its board. `board` has the pins and all hardware access; the
//! library has everything else, with the main loop in [`firmware::program`].
//!
//! INT0 moves frames from the CAN controller to a queue, and Timer0 counts milliseconds: normal
//! operation needs no other interrupt. Timer1 makes the pulse of output 1 without software.

#![cfg_attr(
    target_arch = "avr",
    no_std,
    no_main,
    feature(asm_experimental_arch, abi_avr_interrupt)
)]
#![deny(clippy::undocumented_unsafe_blocks)]
// `avr_device::entry` makes `main` an unsafe function, which is called once, and gives it a `&mut`
// reference to each of its statics.
#![cfg_attr(target_arch = "avr", allow(static_mut_refs, unsafe_op_in_unsafe_fn))]

#[cfg(target_arch = "avr")]
#[deny(unsafe_op_in_unsafe_fn)]
mod board;

#[cfg(target_arch = "avr")]
use {board::Arduino, core::mem::MaybeUninit, firmware::program::Program};

#[cfg(target_arch = "avr")]
#[avr_device::entry]
fn main() -> ! {
    // These are statics and not on the stack, so that the linker counts their RAM.
    static mut PROGRAM: Program = Program::new();
    static mut BOARD: MaybeUninit<Arduino> = MaybeUninit::uninit();
    let (program, board) = (PROGRAM, BOARD.write(Arduino::new()));

    program.start(board);
    loop {
        program.turn(board);
    }
}

/// Prints how to flash and how to simulate: the firmware runs on an Arduino and not on the host.
#[cfg(not(target_arch = "avr"))]
fn main() {
    eprintln!(
        "This is firmware for an Arduino: `make flash PORT=/dev/ttyUSB0` uploads it, `make sim` \
         runs it here."
    );
    std::process::exit(2);
}
