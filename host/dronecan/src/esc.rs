//! equipment.esc.RawCommand: `cmd int14[<=20]`.
//!
//! The index of an element is the index of the motor. [`FULL_POWER`] is full power. For a motor
//! that does not reverse, 0 or less is off. The list is last in the message, so it has no length
//! field. Source: public DSDL, little endian.

use super::types;

/// Full power.
pub const FULL_POWER: i16 = 8191;
const BITS: usize = types::RAW_COMMAND.payload.element_bits as usize;
const COMMANDS_MAX: usize = types::RAW_COMMAND.payload.elements_max as usize;

/// The commands in a payload; `None` unless it has 0 to 20 complete ones.
pub fn decode_commands(payload: &[u8]) -> Option<Vec<i16>> {
    let count = payload.len() * 8 / BITS;
    let fits =
        count <= COMMANDS_MAX && types::RAW_COMMAND.payload.bytes(count as u16) == payload.len();
    let bit = |at: usize| payload[at / 8] >> (7 - at % 8) & 1;
    let number = |from: usize, bits: usize| {
        (from..from + bits).fold(0, |sum, at| sum << 1 | u16::from(bit(at)))
    };
    // The low byte comes first, then the other six bits, each from its most significant bit.
    let command = |index: usize| {
        let low = number(index * BITS, 8);
        let high = number(index * BITS + 8, BITS - 8);
        // The highest of the 14 bits is the sign.
        (high << 8 | low) << (16 - BITS)
    };
    fits.then(|| (0..count).map(|index| command(index) as i16 >> (16 - BITS)).collect())
}

/// The payload of commands; the lower 14 bits of each are used.
pub fn encode_commands(commands: &[i16]) -> Vec<u8> {
    let mut payload = vec![0; types::RAW_COMMAND.payload.bytes(commands.len() as u16)];
    let bits_of = |command: &i16| {
        let [low, high] = command.to_le_bytes();
        let bits = u16::from(low) << (BITS - 8) | u16::from(high) & ((1 << (BITS - 8)) - 1);
        (0..BITS).rev().map(move |bit| bits >> bit & 1 != 0)
    };
    for (at, is_set) in commands.iter().flat_map(bits_of).enumerate() {
        payload[at / 8] |= u8::from(is_set) << (7 - at % 8);
    }
    payload
}
