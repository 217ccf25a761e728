//! The commands for motors in an esc.RawCommand (DSDL uavcan/equipment/esc/1030.RawCommand.uavcan):
//! up to 20 signed integers of 14 bits, one after the other.

/// Bits of a command.
const BITS: usize = 14;

/// The command with this index in the payload of an esc.RawCommand: -8192 to 8191. `None` if the
/// payload ends before it.
///
/// ```
/// // Full speed for the motor 0, and full speed backwards for the motor 1.
/// assert_eq!(dronecan_wire::esc::raw_command(&[0xFF, 0x7C, 0x02, 0x00], 1), Some(-8192));
/// ```
pub fn raw_command(payload: &[u8], index: u8) -> Option<i16> {
    let at = usize::from(index) * BITS;
    // The bits of the command begin in the first of these bytes, and end in the second or third.
    let [first, second] = [payload.get(at / 8)?, payload.get(at / 8 + 1)?];
    let third = payload.get(at / 8 + 2);
    if at + BITS > 8 * payload.len() {
        return None;
    }
    let mut bits = u16::from_be_bytes([*first, *second]);
    let mut behind = third.copied().unwrap_or_default();
    // An even number of bits belongs to the command before.
    for _ in 0..at % 8 / 2 {
        bits = bits << 2 | u16::from(behind >> 6);
        behind <<= 2;
    }
    // The lower byte comes first, then the upper six bits.
    let [low, high] = bits.to_be_bytes();
    Some(i16::from_le_bytes([low, (high as i8 >> 2) as u8]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::golden::bytes;

    /// Written by pydronecan 1.0.27.
    #[test]
    fn commands_equal_pydronecan_s() {
        let payload = bytes("FF 7C 02 00 00 00 40 FF FC 01 03 44 95 55");
        let expected = [8191, -8192, 0, 1, -1, 4096, 4660, 5461];
        for (index, command) in (0..).zip(expected) {
            assert_eq!(raw_command(&payload, index), Some(command), "{index}");
        }
        let twenty = bytes(
            "00 01 90 0C 80 0B 01 90 07 D0 15 80 AF 02 20 0E 10 3E 80 D3 04 B0 10 50 57 81 77 05 \
             40 1A 90 60 81 DB 07",
        );
        for index in 0..18 {
            assert_eq!(raw_command(&twenty, index), Some(100 * i16::from(index)), "{index}");
        }
    }

    #[test]
    fn a_payload_has_as_many_commands_as_fit_in_it() {
        let payload = bytes("FF 7C 02 00 00 00 40");
        for len in 0..=payload.len() {
            let commands = 8 * len / BITS;
            let found =
                (0..20).take_while(|&index| raw_command(&payload[..len], index).is_some()).count();
            assert_eq!(found, commands, "{len}");
            assert!(
                (commands as u8..=255).all(|index| raw_command(&payload[..len], index).is_none()),
                "{len}"
            );
        }
    }
}
