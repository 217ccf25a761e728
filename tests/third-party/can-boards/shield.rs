//! The Seeed CAN-BUS shield: CS on D9, a crystal of 16 MHz, 1 Mbit/s.

pub const CS_IS_D10: bool = false;
pub const CRYSTAL_MHZ: u8 = 16;
