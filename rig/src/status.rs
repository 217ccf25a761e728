//! The numbers in a NodeStatus: health, mode, and the bits of the node's vendor-specific code (docs/status.md).

/// Health.
pub const OK: u8 = 0;
pub const WARNING: u8 = 1;
pub const ERROR: u8 = 2;
pub const CRITICAL: u8 = 3;

/// Mode.
pub const OPERATIONAL: u8 = 0;
pub const INITIALIZATION: u8 = 1;

/// Bits of the vendor-specific status code.
pub const WATCHDOG: u16 = 1 << 0;
pub const BROWN_OUT: u16 = 1 << 1;
pub const PANIC: u16 = 1 << 2;
/// A stray interrupt, or the stack ran into the variables.
pub const STRAY: u16 = 1 << 3;
pub const TRANSFER_ERRORS: u16 = 1 << 4;
pub const FRAMES_LOST: u16 = 1 << 5;
pub const ERROR_PASSIVE: u16 = 1 << 6;
pub const BUS_OFF: u16 = 1 << 7;
pub const GAVE_UP_SENDING: u16 = 1 << 8;
pub const CONTROLLER_LOST: u16 = 1 << 9;
pub const FAILSAFE: u16 = 1 << 10;
pub const TEMPERATURE: u16 = 1 << 11;
pub const SENSOR: u16 = 1 << 12;
pub const PARAMETERS_LOST: u16 = 1 << 13;
pub const DISARMED: u16 = 1 << 14;
pub const DRAFT: u16 = 1 << 15;
