//! The blue MCP2515 module: CS on D10, a crystal of 8 MHz, with which 500 kbit/s is the most.

pub const CS_IS_D10: bool = true;
pub const CRYSTAL_MHZ: u8 = 8;
