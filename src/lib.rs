//! A DroneCAN (UAVCAN v0) servo and temperature node: all of the program that does not access the
//! chip's registers.
//!
//! Each layer uses only the layers below it:
//!
//! * [`program`]: the main loop, over a board.
//! * [`image`]: the tables of constants of all layers, as they lie in flash.
//! * [`node`]: what every node does: receive, send, parameters, health, services.
//! * [`parts`]: what a build may leave out: outputs, power, lights and others, a file each.
//! * [`dialect`]: DroneCAN v0, or the draft of 2014.
//! * [`monitor`]: the serial monitor.
//! * [`tables`]: what is received and published, the parameters, the conditions: a row for each.
//! * [`handover`]: what the program and the bootloader tell each other.
//! * [`eeprom`]: what the program needs of the EEPROM.
//! * [`hardware`]: the board that the program is built for.
//! * [`progmem`]: reads a table of constants from flash.
//! * [`math`]: integer arithmetic.
//! * [`dronecan_wire`]: the wire format, a separate crate.
//! * [`mcp2515_ordered`]: frames, and the driver of the MCP2515 over any `embedded-hal` SPI, a
//!   separate crate.
//!
//! `desk` is a board of plain variables that the tests run the node on.
//!
//! The caller passes the time as an argument and the hardware as traits (`embedded-hal` for SPI and
//! pins), so all of the library is tested on the host. The chip's registers, interrupts and
//! `unsafe` are in `board`, which belongs to the firmware binary alone.
//!
//! # Glossary
//!
//! The code uses these words with a fixed meaning.
//!
//! | word | meaning |
//! | --- | --- |
//! | turn | one pass of the main loop, which does one thing ([`Turn`](node::agenda::Turn)) |
//! | facts | the state from which the agenda chooses a turn ([`Facts`](node::agenda::Facts)) |
//! | tick | the work of each millisecond; `second` is the work of each second |
//! | chore | work that takes too long for the turn that causes it, and gets a turn of its own |
//! | take | accept a value and act on it, or remove a value from its place and return it |
//! | hear | evaluate a received message that decides the dialect or the node ID |
//! | publish, withdraw | make a message due; make it not due |
//! | prepare | do one step towards the next frame to send |
//! | begin, step | start something that takes several turns; do a short part of it |
//! | expire | give up a transfer that is not complete within its timeout |
//! | reject | drop a frame or a transfer, count it, and log the reason ([`Rejection`](dronecan_wire::Rejection)) |
//! | lose | count something that was dropped: a frame, a transfer, or a line of the serial monitor |
//! | conclude | count and log a complete transfer |
//! | follow | let a command set the servo pulse |
//! | set, happened | set a condition for as long as its cause lasts; set it until [`HOLD_S`](tables::condition::HOLD_S) seconds after the last event |
//! | lane | the receiver's place for one transfer of several frames |
//! | segment, verdict | a frame as a part of a transfer; the result of receiving it |
//! | kind | a data type that the node receives ([`Kind`](tables::kind::Kind)) |
//! | row | one entry of a table: a received type, a message to send, or a set of filters ([`Row`](node::acceptance::Row)) |
//! | line, event | a text of the serial monitor; a line with the values for its fields |

#![cfg_attr(not(any(test, feature = "desk")), no_std)]
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![allow(clippy::new_without_default, reason = "`new` is for constants; nothing needs the trait")]
// The compiler evaluates the packing of the texts, which takes a second or two.
#![allow(long_running_const_eval)]

#[cfg(any(test, feature = "desk"))]
pub mod desk;
pub mod dialect;
pub mod eeprom;
#[cfg(test)]
mod golden;
pub mod handover;
pub mod hardware;
pub mod image;
pub mod math;
pub mod monitor;
pub mod node;
pub mod parts;
pub mod progmem;
pub mod program;
pub mod tables;
