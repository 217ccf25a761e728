//! FTP over MAVLink: the bridge has no files and rejects each request.
//!
//! Ground stations request a file of parameters before the parameters themselves, and wait long for
//! an answer. After a rejection they continue at once (MAVLink's chapter "File Transfer Protocol").
//!
//! ```text
//! byte   0..2   2        3       4     5               6               7        8..12   12..
//!        seq    session  opcode  size  req_opcode      burst_complete  padding  offset  data
//! ```

use crate::message::{Content, FTP_PAYLOAD_LEN};
use mavlink::dialects::common::{FILE_TRANSFER_PROTOCOL_DATA, MavMessage};

const OPCODE_AT: usize = 3;
const SIZE_AT: usize = 4;
const REQUEST_OPCODE_AT: usize = 5;
const DATA_AT: usize = 12;

/// MAV_FTP_OPCODE.
mod opcode {
    pub const TERMINATE_SESSION: u8 = 1;
    pub const RESET_SESSIONS: u8 = 2;
    pub const LIST_DIRECTORY: u8 = 3;
    pub const OPEN_FILE_READ_ONLY: u8 = 4;
    pub const CALCULATE_FILE_CRC: u8 = 14;
    pub const ACK: u8 = 128;
    pub const NAK: u8 = 129;
}

/// MAV_FTP_ERR.
mod error {
    pub const UNKNOWN_COMMAND: u8 = 7;
    pub const FILE_NOT_FOUND: u8 = 10;
}

/// The answer to a request to this system and component; `None` if the message is not a request.
pub fn answer(
    (target_system, target_component): (u8, u8),
    request: &[u8; FTP_PAYLOAD_LEN],
) -> Option<Content> {
    let requested = request[OPCODE_AT];
    if requested >= opcode::ACK {
        return None;
    }
    let mut payload = [0; FTP_PAYLOAD_LEN];
    let sequence = u16::from_le_bytes([request[0], request[1]]).wrapping_add(1);
    payload[..2].copy_from_slice(&sequence.to_le_bytes());
    payload[2] = request[2];
    payload[REQUEST_OPCODE_AT] = requested;
    let error = match requested {
        // No session is open, so this succeeds.
        opcode::TERMINATE_SESSION | opcode::RESET_SESSIONS => None,
        opcode::LIST_DIRECTORY | opcode::OPEN_FILE_READ_ONLY | opcode::CALCULATE_FILE_CRC => {
            Some(error::FILE_NOT_FOUND)
        }
        _ => Some(error::UNKNOWN_COMMAND),
    };
    payload[OPCODE_AT] = if error.is_some() { opcode::NAK } else { opcode::ACK };
    if let Some(error) = error {
        payload[SIZE_AT] = 1;
        payload[DATA_AT] = error;
    }
    let data =
        FILE_TRANSFER_PROTOCOL_DATA { target_network: 0, target_system, target_component, payload };
    Some(Content::from(MavMessage::FILE_TRANSFER_PROTOCOL(data)))
}
