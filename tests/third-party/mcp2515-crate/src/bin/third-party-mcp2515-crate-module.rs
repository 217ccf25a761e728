//! The firmware for the blue module.
#![cfg_attr(target_arch = "avr", no_std, no_main)]

#[cfg(not(target_arch = "avr"))]
fn main() {}

#[cfg(target_arch = "avr")]
#[path = "../../../board.rs"]
mod board;
#[cfg(target_arch = "avr")]
#[path = "../../../can-boards/module.rs"]
mod can_board;
#[cfg(target_arch = "avr")]
#[path = "../firmware.rs"]
mod firmware;
#[cfg(target_arch = "avr")]
#[path = "../../../job.rs"]
mod job;
