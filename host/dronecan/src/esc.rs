//! equipment.esc.RawCommand: `cmd int14[<=20]`.
//!
//! The index of an element is the index of the motor. [`FULL_POWER`] is full power. For a motor
//! that does not reverse, 0 or less is off. The list is last in the message, so it has no length
//! field. Source: public DSDL, little endian.

use super::bits::{Reader, Writer};
use super::fields::Field;
use super::types;

/// Full power.
pub const FULL_POWER: i16 = 8191;
const BITS: u32 = types::RAW_COMMAND.payload.element_bits as u32;
const COMMANDS_MAX: usize = types::RAW_COMMAND.payload.elements_max as usize;

/// The commands in a payload; `None` unless it has 0 to 20 complete ones.
pub fn decode_commands(payload: &[u8]) -> Option<Vec<i16>> {
    let count = payload.len() * 8 / BITS as usize;
    let fits =
        count <= COMMANDS_MAX && types::RAW_COMMAND.payload.bytes(count as u16) == payload.len();
    let mut bits = Reader::new(payload);
    let command = |_| i16::take(&mut bits, BITS);
    if fits { (0..count).map(command).collect() } else { None }
}

/// The payload of commands; the lower 14 bits of each are used.
pub fn encode_commands(commands: &[i16]) -> Vec<u8> {
    let mut bits = Writer::default();
    commands.iter().for_each(|command| command.put(&mut bits, BITS));
    bits.into_bytes()
}
