//! Fields of messages that the `mavlink` crate cannot represent.
//!
//! The crate's messages have closed enumerations. A message with a value that the crate does not
//! know can be neither read (<https://github.com/mavlink/rust-mavlink/issues/112>) nor written. But
//! the bridge must answer an unknown command with UNSUPPORTED, and must pass on a vendor's mode. So
//! for received messages it takes such a field out of the payload and puts in a value that the
//! crate knows. In sent messages it writes the field over what the crate wrote.
//!
//! The offsets are in the payload, in which MAVLink orders the fields by size, largest first.

use super::command;

/// The longest payload of a message.
pub const PAYLOAD_MAX: usize = 255;

/// Offset of COMMAND_LONG.command and COMMAND_INT.command: after seven fields of four bytes.
const COMMAND_AT: usize = 28;
/// Offset of COMMAND_INT.frame: after the command and the two targets.
const INT_FRAME_AT: usize = 32;
const KNOWN_INT_FRAME: u8 = 0;
/// Offset of PARAM_SET.param_type: after the value, the two targets and the name.
const PARAM_TYPE_AT: usize = 22;
/// MAV_PARAM_TYPE_REAL32.
const KNOWN_PARAM_TYPE: u8 = 9;
/// Offset of UAVCAN_NODE_STATUS.mode: after 8, 4 and 2 bytes, and the health.
const STATUS_MODE_AT: usize = 15;
const ACK_COMMAND_AT: usize = 0;
/// Offsets of HEARTBEAT.type and HEARTBEAT.autopilot: after the custom mode.
const HEARTBEAT_TYPE_AT: usize = 4;
const HEARTBEAT_AUTOPILOT_AT: usize = 5;

/// Takes the number of a COMMAND_LONG or COMMAND_INT out of its payload.
pub fn take_command(payload: &mut [u8; PAYLOAD_MAX]) -> u16 {
    let number = u16::from_le_bytes([payload[COMMAND_AT], payload[COMMAND_AT + 1]]);
    payload[COMMAND_AT..COMMAND_AT + 2].copy_from_slice(&command::REQUEST_MESSAGE.to_le_bytes());
    number
}

/// Replaces the frame of a COMMAND_INT. No command of the bridge has a position.
pub fn replace_frame(payload: &mut [u8; PAYLOAD_MAX]) {
    payload[INT_FRAME_AT] = KNOWN_INT_FRAME;
}

/// The type and the autopilot of a HEARTBEAT.
pub fn heartbeat_kind(payload: &[u8; PAYLOAD_MAX]) -> (u8, u8) {
    (payload[HEARTBEAT_TYPE_AT], payload[HEARTBEAT_AUTOPILOT_AT])
}

/// Takes the type of a PARAM_SET out of its payload.
pub fn take_param_type(payload: &mut [u8; PAYLOAD_MAX]) -> u8 {
    std::mem::replace(&mut payload[PARAM_TYPE_AT], KNOWN_PARAM_TYPE)
}

/// Writes the mode into a UAVCAN_NODE_STATUS of `len` bytes. Returns the new length.
pub fn put_mode(payload: &mut [u8], len: usize, mode: u8) -> usize {
    put(payload, len, STATUS_MODE_AT, &[mode])
}

/// Writes the number of the command into a COMMAND_ACK of `len` bytes. Returns the new length.
pub fn put_acknowledged_command(payload: &mut [u8], len: usize, number: u16) -> usize {
    put(payload, len, ACK_COMMAND_AT, &number.to_le_bytes())
}

/// Writes `bytes` at `at` into a payload of `len` bytes without its trailing zeros. Returns the new
/// length.
fn put(payload: &mut [u8], len: usize, at: usize, bytes: &[u8]) -> usize {
    payload[at..at + bytes.len()].copy_from_slice(bytes);
    let last = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| at + last + 1);
    len.max(last)
}
