//! The blue MCP2515 module: CS on D10, a crystal of 8 MHz, which allows at most 500 kbit/s.

pub const CS_IS_D10: bool = true;
pub const CRYSTAL_MHZ: u8 = 8;
