//! uavcan.equipment.device.Temperature (DSDL 1110.Temperature.uavcan): the temperature of a device.
//!
//! ```text
//! device_id[0..2] LE; temperature[2..4] float16 LE, kelvin; error_flags[4]
//! ```
//!
//! From 256 to 512 K a float16 has steps of 0.25 K.

use super::float16;

/// Data type ID.
pub const DATA_TYPE_ID: u16 = 1110;

/// Bytes of the payload.
pub const LEN: usize = 5;

/// The message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Temperature {
    /// Which device.
    pub device_id: u16,
    /// In 64ths of a kelvin. Finer than what is sent, so that rounding twice does not round wrong.
    pub kelvin_64ths: u16,
}

impl Temperature {
    /// The payload. No error flag is set: the node has no limits to judge by.
    pub fn emit(&self) -> [u8; LEN] {
        let [d0, d1] = self.device_id.to_le_bytes();
        let [t0, t1] = float16::from_fixed(self.kelvin_64ths, 6).to_le_bytes();
        [d0, d1, t0, t1, 0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn golden_bytes_are_made() {
        let temperature = Temperature { device_id: 1, kelvin_64ths: (298.15 * 64.0) as u16 };
        assert_eq!(temperature.emit(), [0x01, 0x00, 0xA9, 0x5C, 0x00]);
    }
}
