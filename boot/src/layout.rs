//! The layout of what is in RAM (`variables.rs`): a frame, a received transfer, what the node says
//! about itself, and the update.

use firmware::handover::{BUS, IMAGE_CRC_LEN, REQUEST_LEN, SOFTWARE_VERSION_LEN, UNIQUE_ID};

/// Bytes of a transfer in a frame, before the tail.
pub const BYTES_PER_FRAME: u8 = 7;
/// Bytes of the CRC of a transfer of several frames.
pub const CRC_LEN: u16 = 2;

/// Room in the buffer of received transfers: an answer to file.Read with 256 bytes of data, and the
/// rest of a frame that is too much.
pub const RECEIVED_LEN: usize = CRC_LEN as usize + 2 + 256 + BYTES_PER_FRAME as usize;

/// A frame as the chip has it.
#[repr(C)]
pub struct Frame {
    /// SIDH, SIDL, EID8 and EID0.
    pub id: [u8; 4],
    /// DLC.
    pub len: u8,
    /// The data.
    pub data: [u8; 8],
}

/// Length of version and CRC of the program.
pub const SOFTWARE_LEN: usize = SOFTWARE_VERSION_LEN + IMAGE_CRC_LEN;

/// Room for the CRC, the payload of GetNodeInfo, and what follows in the EEPROM.
#[repr(C)]
pub struct Information {
    pub crc: [u8; 2],
    pub uptime_s: [u8; 4],
    pub mode: u8,
    pub vendor_status: [u8; 2],
    /// Version and CRC of the program. Zero if there is no valid one.
    pub software: [u8; SOFTWARE_LEN],
    pub hardware_version: [u8; 2],
    /// Here the image of the EEPROM begins.
    pub unique_id: [u8; 16],
    /// In the EEPROM, this and the following bytes are more of the record of the unique ID.
    pub certificate_len: u8,
    pub rest: [u8; (BUS - UNIQUE_ID) as usize - 17],
    pub node_id: u8,
    /// CNF3, CNF2 and CNF1 of the MCP2515: the bit rate.
    pub cnf: [u8; 3],
    pub bus_crc: [u8; 2],
}

impl Information {
    /// Length of a NodeStatus.
    pub const STATUS_LEN: u8 = 7;
    /// Length of a response of GetNodeInfo without a name.
    pub const LEN: u8 = 41;
}

/// A request of file.Read, with room for the CRC before it, and the rest of the request for the
/// update.
#[repr(C)]
pub struct Update {
    /// Length of the program. Set with the first answer.
    pub length: u16,
    pub crc: [u8; 2],
    pub offset: [u8; 5],
    /// What a program hands over: path, length of the path, node ID of the server, CRC (see
    /// [`firmware::handover`]).
    pub request: [u8; REQUEST_LEN],
}
