//! A DroneCAN (UAVCAN v0) servo and temperature node: everything of it that does not touch the chip.
//!
//! The layers, each of which knows only those below it:
//!
//! * [`image`]: the constants of all of them, as the flash has them.
//! * [`node`]: what the node does with commands, its servo, its temperature and its status.
//! * [`monitor`]: what it tells on the serial monitor.
//! * [`dronecan`]: the wire format.
//! * [`progmem`]: how a table of constants in flash is read.
//! * [`can`]: frames, and the MCP2515 over any `embedded-hal` SPI.
//! * `desk`: a board of plain variables for the node, with which it is tested.
//!
//! Time comes in as an argument and hardware as `embedded-hal` traits, so all of it is tested on the host. The
//! ATmega168's registers, interrupts and `unsafe` are in `board`, which belongs to the firmware binary alone.

#![cfg_attr(not(any(test, feature = "desk")), no_std)]
#![forbid(unsafe_code)]
#![deny(missing_docs)]
// The texts are packed while compiling, which takes a second or two.
#![allow(long_running_const_eval)]

pub mod can;
#[cfg(any(test, feature = "desk"))]
pub mod desk;
pub mod dronecan;
#[cfg(test)]
mod golden;
pub mod image;
pub mod monitor;
pub mod node;
pub mod progmem;
