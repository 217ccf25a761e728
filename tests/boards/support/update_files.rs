//! Files for updates, as `make firmware` leaves them, and EEPROMs for the bootloader.

use std::ops::Range;
use std::path::PathBuf;

use bench::avr::Chip;
use bench::wiring::Wiring;
use bench::{chosen_board, firmware, node_elf};

/// Address of the header in a program: hardware major, minor, software major, minor, length.
pub const HEADER: usize = 0x68;
/// Addresses of the unique ID in the EEPROM, and of what follows: its CRC, and a marker.
pub const UNIQUE_ID: Range<usize> = 0x04..0x14;
/// Address of node ID and bit rate in the EEPROM.
pub const BUS: usize = 0x18;

pub fn board() -> Wiring {
    chosen_board().unwrap_or_else(|error| panic!("{error:#}"))
}

/// CRC-16-CCITT-FALSE.
pub fn crc(bytes: &[u8]) -> u16 {
    crc_from(0xFFFF, bytes)
}

/// The same, from this value on.
fn crc_from(start: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(start, |crc, byte| {
        let crc = crc ^ u16::from(*byte) << 8;
        (0..8).fold(crc, |crc, _| crc << 1 ^ if crc & 0x8000 != 0 { 0x1021 } else { 0 })
    })
}

/// A firmware that hands updates over to the bootloader. On the ATmega168 it has no serial monitor.
pub fn elf() -> PathBuf {
    let elf = if board().chip == Chip::Atmega168 { firmware("remote") } else { node_elf() };
    elf.unwrap_or_else(|error| panic!("{error:#}"))
}

/// The update file of that firmware.
pub fn file() -> Vec<u8> {
    let path = elf().with_extension("bin");
    std::fs::read(&path)
        .unwrap_or_else(|error| panic!("{}: {error}; run \"make firmwares\"", path.display()))
}

/// Replaces the two bytes in the header with which the CRC of a program is 0, after a change of its
/// bytes.
pub fn with_crc(mut file: Vec<u8>) -> Vec<u8> {
    let check = HEADER + 6;
    file[check..check + 2].fill(0);
    // The CRC before the two bytes that the rest of the file would turn into 0.
    let wanted = file[check..].iter().rev().fold(0, |crc: u16, byte| {
        let before = (0..8)
            .fold(crc, |crc, _| if crc & 1 != 0 { (crc ^ 0x1021) >> 1 | 0x8000 } else { crc >> 1 });
        before ^ u16::from(*byte) << 8
    });
    let is = crc(&file[..check]);
    file[check..check + 2].copy_from_slice(&(is ^ wanted).to_be_bytes());
    file
}

/// An EEPROM with a unique ID, and with node ID 42 and 125 kbit/s for the bootloader.
pub fn eeprom_with_bus_record() -> [u8; 0x20] {
    let mut eeprom = [0xFF; 0x20];
    let id = [0xA5; 16];
    eeprom[UNIQUE_ID].copy_from_slice(&id);
    eeprom[UNIQUE_ID.end..][..2].copy_from_slice(&crc_from(0x0100, &id).to_be_bytes());
    eeprom[UNIQUE_ID.end + 2] = 0;
    // CNF3, CNF2 and CNF1: 16 or 8 quanta of 2 x (BRP + 1) / F_OSC, with the sample point at
    // 87.5 %.
    let brp = if board().crystal_hz() == 16_000_000 { 3 } else { 1 };
    let record = [42, 0x01, 0xBC, brp];
    eeprom[BUS..BUS + 4].copy_from_slice(&record);
    eeprom[BUS + 4..BUS + 6].copy_from_slice(&crc(&record).to_be_bytes());
    eeprom
}
