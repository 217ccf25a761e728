//! Simulated boards on a simulated CAN bus, for tests of firmware: no screen, no network.
//!
//! [`Bench`] runs [boards](board) and other stations on one bus. A board has an AVR, an MCP2515,
//! and the parts that [`wiring`] connects to them. [`autopilot`] commands it like ArduPilot or PX4.

#![forbid(unsafe_code)]

mod bench;

pub mod autopilot;
pub mod board;
pub mod budget;
pub mod firmware;
pub mod lm35;
pub mod wiring;

/// The models of the chips and of the bus, and the DroneCAN code of the other stations.
pub use {avr_model as avr, can_model as can, dronecan_host as dronecan, mcp2515_model as mcp2515};

pub use bench::Bench;
pub use firmware::{
    bootloader, chosen_board, eeprom_after_first_start, firmware, firmware_for, node_elf, root,
    target_dir,
};
pub use sim_base::{Cycles, F_CPU_HZ, Noise, elapsed, thousands};
