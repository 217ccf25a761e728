//! The firmwares on drivers of others, which test the simulator's MCP2515: a job and a board for
//! each driver. A program of `src/bin` is one driver on one CAN board.
#![cfg_attr(target_arch = "avr", no_std)]
#![cfg(target_arch = "avr")]

pub mod board;
mod job;
pub mod mcp2515;
pub mod mcp25xx;
