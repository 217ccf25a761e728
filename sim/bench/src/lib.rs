//! Simulated boards on a simulated CAN bus, for tests of firmware: no screen, no network.
//!
//! [`Bench`] runs [boards](board) and other stations on one bus. A board has an AVR, an MCP2515,
//! and the parts that [`wiring`] connects to them. [`autopilot`] commands it like ArduPilot or PX4.
//! The processor is that of `avr-model`, with simavr if the feature `simavr` is on. Without the
//! feature `avr-model`, boards name another one.

#![forbid(unsafe_code)]

mod bench;

pub mod autopilot;
pub mod board;
pub mod budget;
pub mod bus_log;
pub mod fault;
pub mod findings;
#[cfg(feature = "avr-model")]
pub mod firmware;
pub mod i2c;
pub mod inject;
pub mod lm35;
pub mod pins;
pub mod script;
pub mod shaft;
pub mod vcd;
pub mod vendor_code;
pub mod wires;
pub mod wiring;

/// The models of the chips and of the bus, and the DroneCAN code of the other stations.
pub use {can_model as can, dronecan_host as dronecan, mcp2515_model as mcp2515};

/// What models of the chips share.
#[cfg(not(feature = "avr-model"))]
pub use avr_chip as avr;
/// The processor of a board, and all that models of the chips share.
#[cfg(feature = "avr-model")]
pub use avr_model as avr;

/// The processor of a board for which none is named.
#[cfg(feature = "avr-model")]
pub type StandardProcessor = avr_model::Avr;
/// The processor of a board for which none is named: none. A board names its own.
#[cfg(not(feature = "avr-model"))]
pub type StandardProcessor = std::convert::Infallible;

pub use bench::Bench;
#[cfg(feature = "avr-model")]
pub use firmware::{
    bootloader, chosen_board, eeprom_after_first_start, firmware, firmware_for, node_elf, root,
    target_dir,
};
pub use sim_base::{Cycles, F_CPU_HZ, Noise, elapsed, thousands};
