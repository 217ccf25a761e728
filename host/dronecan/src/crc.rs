//! The transfer CRC: CRC-16-CCITT-FALSE (polynomial 0x1021, start 0xFFFF, not reflected), fed with
//! the data type signature before the payload (DroneCAN specification, "CAN bus transport layer",
//! multi-frame transfers).

/// Start value before the signature.
pub const INITIAL: u16 = 0xFFFF;

/// Feeds `bytes` to a running CRC.
pub fn feed(crc: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(crc, |crc, &byte| {
        (0..8).fold(crc ^ (u16::from(byte) << 8), |crc, _| {
            let shifted = crc << 1;
            if crc & 0x8000 == 0 { shifted } else { shifted ^ 0x1021 }
        })
    })
}

/// CRC of the eight signature bytes, little endian: the start value of a transfer of this type.
pub fn seed(signature: u64) -> u16 {
    feed(INITIAL, &signature.to_le_bytes())
}

/// CRC of a complete transfer.
pub fn transfer(signature: u64, payload: &[u8]) -> u16 {
    feed(seed(signature), payload)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The check value that the CRC catalogues give for this parameter set.
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
