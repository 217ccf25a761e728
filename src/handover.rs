//! What the program and the bootloader (`boot/`) tell each other: layouts and addresses.
//! docs/update.md describes the file of a program.
//!
//! | where | what |
//! | --- | --- |
//! | flash, [`HEADER`] | header of the program: its board, version and length |
//! | flash, [`SOFTWARE_VERSION`] | its version for GetNodeInfo, and the application descriptor |
//! | EEPROM, [`UNIQUE_ID`] | the unique ID |
//! | EEPROM, [`BUS`] | node ID and bit rate, for a loader that starts without a program |
//! | last bytes of the RAM, from [`REQUEST`] on | the update that the program asks for, and the count of watchdog restarts |
//!
//! Each record ends with a CRC of the bytes before it (CRC-16-CCITT-FALSE, high byte first), so
//! that the CRC of the whole record is 0.

/// Initial value of the CRC of a record, and of a program. Neither zeros nor erased bytes are valid
/// with it.
pub const CRC_START: u16 = 0xFFFF;

/// Byte address of the header of the program: behind the 26 vectors, in the first page.
pub const HEADER: u16 = 0x68;
/// Length of the header: major and minor hardware version, major and minor software version, length
/// of the program, and two bytes with which the CRC of the program is 0.
pub const HEADER_LEN: usize = 8;
/// Offset in the header of the length of the program in bytes. Little-endian. scripts/image writes
/// it and the two bytes behind it. The loader starts no program without them.
pub const HEADER_LENGTH: usize = 4;

/// Added to the major hardware version in the response of GetNodeInfo while the node takes no
/// updates over the bus, so that no server has a file for it. PX4 would ask again every 250 ms
/// after a refusal, and not arm. The header has the version of the board at all times.
pub const TAKES_NO_UPDATES: u8 = 0x80;

/// Byte address of the software version of the program, as in the response of GetNodeInfo: major,
/// minor, flags, commit.
pub const SOFTWARE_VERSION: u16 = 0x71;
/// Length of the software version.
pub const SOFTWARE_VERSION_LEN: usize = 7;
/// Byte address of the application descriptor, by which file servers know an image: a multiple of
/// 8.
pub const DESCRIPTOR: u16 = SOFTWARE_VERSION + SOFTWARE_VERSION_LEN as u16;
/// Length of the descriptor: signature (8 bytes), CRC of the image (8), length of the image (4),
/// commit (4), major and minor version, ID of the board (2), reserved (8). Little-endian.
pub const DESCRIPTOR_LEN: usize = 36;
/// Offset in the descriptor of the CRC of the image, which GetNodeInfo tells.
pub const IMAGE_CRC: usize = 8;
/// Length of the CRC of the image.
pub const IMAGE_CRC_LEN: usize = 8;

const _: () = assert!(DESCRIPTOR.is_multiple_of(8));

/// Address in EEPROM of the unique ID, which the loader or the program makes at its first start.
/// The first addresses are unused: a failing supply most likely corrupts them.
pub const UNIQUE_ID: u8 = 0x04;
/// Bytes of a unique ID (DSDL uavcan/protocol/HardwareVersion.uavcan).
pub const UNIQUE_ID_LEN: u8 = 16;
/// Length of its record: the ID, its CRC, and a marker of 0.
pub const UNIQUE_ID_RECORD_LEN: u8 = UNIQUE_ID_LEN + 3;
/// Initial value of the CRC of the unique ID, which makes a record of zeros invalid.
pub const UNIQUE_ID_CRC_START: u16 = 0x0100;

/// Address in EEPROM of the record of the bus: node ID; CNF3, CNF2 and CNF1 of the MCP2515 (the bit
/// rate); CRC.
pub const BUS: u8 = 0x18;
/// Length of the record of the bus.
pub const BUS_LEN: u8 = 6;

/// Bytes at the end of the RAM that the start-up code and the stack leave alone.
pub const SHARED_RAM: u16 = 32;
/// Offset in the shared RAM of the request for an update: path, length of the path, node ID of the
/// server, CRC.
pub const REQUEST: u16 = 0;
/// The longest path that a request has room for.
pub const PATH_LEN: usize = 24;
/// Length of the request.
pub const REQUEST_LEN: usize = PATH_LEN + 4;
/// Offset in the shared RAM of the count of watchdog restarts since the last other reset. The
/// program clears it after a minute.
pub const RESTARTS: u16 = 28;

const _: () = assert!(REQUEST + (REQUEST_LEN as u16) <= RESTARTS && RESTARTS < SHARED_RAM);
