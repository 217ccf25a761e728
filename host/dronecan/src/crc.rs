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

#[cfg(test)]
mod tests {
    use super::*;

    /// The check value that the CRC catalogues give for CRC-16-CCITT-FALSE.
    #[test]
    fn the_check_value_is_that_of_the_catalogues() {
        assert_eq!(feed(INITIAL, b"123456789"), 0x29B1);
    }

    /// Seeds computed with pydronecan 1.0.27.
    #[test]
    fn seeds_equal_those_of_pydronecan() {
        assert_eq!(seed(0xEE46_8A81_21C4_6A9E), 0xD9A7); // GetNodeInfo
        assert_eq!(seed(0xD8A7_4862_38EC_3AF3), 0x5E37); // ArrayCommand
        assert_eq!(seed(0x5E9B_BA44_FAF1_EA04), 0x9A63); // actuator.Status
        assert_eq!(seed(0xCE08_0CAE_3CA3_3C75), 0xE601); // CanStats
    }
}
