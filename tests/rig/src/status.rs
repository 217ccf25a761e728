//! The numbers in a NodeStatus: health, mode, and the bits of the vendor-specific status code
//! (docs/status.md).

/// Health.
pub const OK: u8 = 0;
pub const WARNING: u8 = 1;
pub const ERROR: u8 = 2;
pub const CRITICAL: u8 = 3;

/// Mode.
pub const OPERATIONAL: u8 = 0;
pub const INITIALIZATION: u8 = 1;

/// Mask of the lowest three bits of the vendor-specific status code: the cause of the last reset,
/// one of the numbers below.
pub const RESET: u16 = 7;
pub const WATCHDOG: u16 = 1;
pub const BROWN_OUT: u16 = 2;
pub const PANIC: u16 = 3;
pub const STRAY_INTERRUPT: u16 = 4;
pub const STACK_COLLISION: u16 = 5;
/// Bits of the vendor-specific status code above the cause.
pub const TRANSFER_ERRORS: u16 = 1 << 3;
pub const ID_CONFLICT: u16 = 1 << 4;
pub const FRAMES_LOST: u16 = 1 << 5;
pub const ERROR_PASSIVE: u16 = 1 << 6;
pub const BUS_OFF: u16 = 1 << 7;
/// The node restarted the controller, or dropped a frame that it could not send.
pub const CONTROLLER: u16 = 1 << 8;
pub const TWO_COMMANDERS: u16 = 1 << 9;
pub const FAILSAFE: u16 = 1 << 10;
/// The temperature is out of range, or the sensor is open or shorted.
pub const TEMPERATURE: u16 = 1 << 11;
/// The voltage or the current of the circuit is out of range.
pub const POWER: u16 = 1 << 12;
pub const PARAMETERS_LOST: u16 = 1 << 13;
pub const DISARMED: u16 = 1 << 14;
pub const DRAFT: u16 = 1 << 15;
