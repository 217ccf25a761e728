//! The commands for motors in an esc.RawCommand (DSDL uavcan/equipment/esc/1030.RawCommand.uavcan):
//! up to 20 signed integers of 14 bits, one after the other.

/// The command with this index in the payload of an esc.RawCommand: -8192 to 8191. `None` if the
/// payload ends before it.
///
/// ```
/// // Full speed for the motor 0, and full speed backwards for the motor 1.
/// assert_eq!(dronecan_wire::esc::raw_command(&[0xFF, 0x7C, 0x02, 0x00], 1), Some(-8192));
/// ```
#[inline(never)]
pub fn raw_command(payload: &[u8], index: u8) -> Option<i16> {
    let bytes = payload.get(usize::from(index) * 7 / 4..)?;
    let (&[first, second], rest) = bytes.split_first_chunk()?;
    // The lower byte comes first, then the upper six bits. Bits fill a byte from its highest.
    let (low, high) = match index % 4 {
        0 => (first, second),
        1 => (first << 6 | second >> 2, second << 6 | rest.first()? >> 2),
        2 => (first << 4 | second >> 4, second << 4 | rest.first()? >> 4),
        _ => (first << 2 | second >> 6, second << 2),
    };
    Some(i16::from_le_bytes([low, (high as i8 >> 2) as u8]))
}

/// The number of commands in a payload of an esc.RawCommand with this length, in bytes.
#[inline(always)]
pub fn raw_commands(len: u8) -> u8 {
    // Four commands take seven bytes. Two, four and six have room for one, two and three.
    let (mut commands, mut rest) = (0u8, len);
    while rest >= 7 {
        rest -= 7;
        commands += 4;
    }
    commands + rest / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bits of a command.
    const BITS: usize = 14;

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
            assert_eq!(usize::from(raw_commands(len as u8)), commands, "{len}");
            assert!(
                (commands as u8..=255).all(|index| raw_command(&payload[..len], index).is_none()),
                "{len}"
            );
        }
    }
}
