//! Simulated boards on a simulated CAN bus, for tests of firmware: no screen, no network.
//!
//! [`Bench`] runs [boards](board) and other stations on one bus. A board has an AVR, an MCP2515,
//! and the parts that [`wiring`] connects to them. [`autopilot`] commands it like ArduPilot or PX4.
//! The processor is that of `avr-model`, with simavr if the feature `simavr` is on.

#![forbid(unsafe_code)]

mod bench;

pub mod autopilot;
pub mod board;
/// The table of boards, which the build scripts of the firmware read, too.
#[path = "../../../avr-specs/boards.rs"]
pub mod boards;
pub mod budget;
pub mod bus_log;
pub mod corner;
pub mod fault;
pub mod findings;
pub mod firmware;
pub mod i2c;
pub mod inject;
pub mod lm35;
pub mod node_ids;
pub mod pins;
pub mod script;
pub mod serial_line;
pub mod shaft;
pub mod slcan;
pub mod vcd;
pub mod vendor_code;
pub mod wires;
pub mod wiring;

/// The models of the chips and of the bus, and the DroneCAN code of the other stations.
pub use {can_model as can, dronecan_host as dronecan, mcp2515_model as mcp2515};

/// The processor of a board.
pub use avr_model as avr;

pub use bench::Bench;
pub use firmware::{
    bootloader, chosen_board, eeprom_after_first_start, firmware, firmware_for, firmware_like,
    node_elf, root, target_dir,
};
pub use sim_base::{Cycles, F_CPU_HZ, Noise, elapsed, thousands};
