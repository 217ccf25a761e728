//! The bootloader: takes a program over DroneCAN, writes it, and starts it. docs/update.md
//! describes it to its users.
//!
//! The story: a reset leads to `start.rs`, which calls `main` in `loader.rs`. That decides whether
//! the program starts (`start::decide`). If not, the loader is one loop without interrupts. Each
//! turn sends at most one transfer: the NodeStatus of each second, a request for the next part of
//! the file, or the answer to a request.
//!
//! | file | what it does |
//! | --- | --- |
//! | `start.rs` | from the reset to the decision: start the program, or stay |
//! | `loader.rs` | `main`, its loop, and the answers to requests |
//! | `update.rs` | reads the file, and writes the program |
//! | `listen.rs` | finds the bit rate before it sends |
//! | `serial.rs` | takes a program through the serial port |
//! | `image.rs` | checks the program in flash |
//! | `node_info.rs` | what the node says about itself |
//! | `eeprom.rs` | unique ID, node ID and bit rate in EEPROM |
//! | `transfer.rs` | frames to transfers, transfers to frames |
//! | `can.rs` | the MCP2515 |
//! | `layout.rs`, `variables.rs` | the RAM |
//! | `on_host.rs` | what tests on the host have in place of the chip |
//! | `spm.rs`, `clock.rs`, `registers.rs`, `crc.rs` | the chip, and the CRC |
//!
//! The code is bent for size, with rustc of rust-toolchain.toml and the options of scripts/boot:
//! `main` contains all functions but a few short ones. Loops end with `if left == 0 {
//! break }` instead of `for`, which takes four bytes less. Variables of a byte are in I/O registers
//! that have no other use. docs/decisions.md has what that is worth.

#![cfg_attr(target_arch = "avr", no_std, no_main, feature(asm_experimental_arch))]
#![deny(unsafe_op_in_unsafe_fn, clippy::undocumented_unsafe_blocks)]

#[cfg(target_arch = "avr")]
mod can;
#[cfg(target_arch = "avr")]
mod clock;
#[cfg(target_arch = "avr")]
mod crc;
#[cfg(target_arch = "avr")]
mod eeprom;
#[cfg(target_arch = "avr")]
mod image;
#[cfg(any(target_arch = "avr", test))]
#[cfg_attr(test, allow(dead_code))] // Tests run `transfer.rs`.
mod layout;
#[cfg(target_arch = "avr")]
mod listen;
#[cfg(target_arch = "avr")]
mod loader;
#[cfg(target_arch = "avr")]
mod node_info;
#[cfg(target_arch = "avr")]
mod registers;
#[cfg(target_arch = "avr")]
mod serial;
#[cfg(target_arch = "avr")]
mod spm;
#[cfg(target_arch = "avr")]
mod start;
#[cfg(any(target_arch = "avr", test))]
mod transfer;
#[cfg(target_arch = "avr")]
mod update;
#[cfg(target_arch = "avr")]
mod variables;

#[cfg(all(test, not(target_arch = "avr")))]
mod on_host;
#[cfg(all(test, not(target_arch = "avr")))]
use on_host::{can, crc, registers, variables};

/// Says how to build it: the loader runs on an Arduino and not on the host.
#[cfg(not(target_arch = "avr"))]
fn main() {
    eprintln!("This is firmware for an Arduino: `make boot` builds it.");
    std::process::exit(2);
}
