//! The transfer CRC (DroneCAN specification, "CAN bus transport layer", multi-frame transfers).
//! [`seed`] is its value after the data type signature: each data type has one.

pub use dronecan_wire::crc::seed;
use dronecan_wire::crc::step;

/// Start value before the signature.
pub const INITIAL: u16 = 0xFFFF;

/// Feeds `bytes` to a running CRC.
pub fn feed(crc: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(crc, |crc, &byte| step(crc, byte))
}
