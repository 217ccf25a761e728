//! The numbers in a NodeStatus: health, mode, and the bits of the vendor-specific status code.

pub use bench::vendor_code::*;

/// Health.
pub const OK: u8 = 0;
pub const WARNING: u8 = 1;
pub const ERROR: u8 = 2;
pub const CRITICAL: u8 = 3;

/// Mode.
pub const OPERATIONAL: u8 = 0;
pub const INITIALIZATION: u8 = 1;
