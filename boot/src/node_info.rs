//! What the node says about itself: NodeStatus, and the response of GetNodeInfo, which begins with
//! the same bytes (DSDL 341.NodeStatus and 1.GetNodeInfo). So both are sent from the same buffer.
//! The name is empty, which all clients accept.

use core::arch::asm;

use firmware::handover::{BUS_LEN, CRC_START, IMAGE_CRC, IMAGE_CRC_LEN, SOFTWARE_VERSION};
use firmware::hardware::{CAN_CRYSTAL_HZ, HARDWARE_MAJOR, HARDWARE_MINOR};
use firmware::tables::bit_rate::HIGHEST_RATE;
use mcp2515_ordered::BitTiming;

use crate::layout::SOFTWARE_LEN;
use crate::registers::{Register, idle};
use crate::variables::{CNF1, CNF2, CNF3, NODE_ID, information};
use crate::{crc, eeprom};

/// Mode of the node, in its bits of NodeStatus. The health is zero, OK.
pub const MODE: Register = idle::GPIOR0;
pub const MAINTENANCE: u8 = 2 << 3;
pub const SOFTWARE_UPDATE: u8 = 3 << 3;

/// Node ID without a record in EEPROM.
const DEFAULT_NODE_ID: u8 = 120;

/// Bit rate without a record in EEPROM: the highest one of the board.
const DEFAULT_TIMING: BitTiming = BitTiming::new(CAN_CRYSTAL_HZ, 125_000 << HIGHEST_RATE);

/// Tells the version of the program in flash, and the CRC of its image.
#[inline(always)]
pub fn take_version() {
    // SAFETY: the pointer is to a variable, so the field is valid. The block only reads flash, and
    // writes the bytes of the field.
    unsafe {
        let to = &raw mut (*information()).software;
        asm!(
            "2: lpm {byte}, Z+",
            "st X+, {byte}",
            "dec {left}",
            "cpi {left}, {crc_len}",
            "brne 3f",
            // Behind the version, which the descriptor follows.
            "adiw r30, {before_crc}",
            "3: cpi {left}, 0",
            "brne 2b",
            byte = out(reg) _, left = inout(reg_upper) SOFTWARE_LEN as u8 => _,
            inout("Z") SOFTWARE_VERSION => _, inout("X") to => _,
            crc_len = const IMAGE_CRC_LEN, before_crc = const IMAGE_CRC, options(nostack)
        );
    }
}

/// Reads the EEPROM, and writes what is not zero and does not change.
#[inline(always)]
pub fn set_up() {
    let information = information();
    // SAFETY: the pointer is to a variable, so its fields are valid. The fields from the unique ID
    // on are as long as the image of the EEPROM.
    unsafe {
        eeprom::read_records((&raw mut (*information).unique_id).cast());
        (&raw mut (*information).certificate_len).write(0);
        (&raw mut (*information).hardware_version).write([HARDWARE_MAJOR, HARDWARE_MINOR]);
        // The record ends the struct.
        if crc::of(CRC_START, &raw const (*information).node_id, BUS_LEN.into()) == 0 {
            return;
        }
    }
    NODE_ID.write(DEFAULT_NODE_ID);
    CNF3.write(DEFAULT_TIMING.cnf3());
    CNF2.write(DEFAULT_TIMING.cnf2());
    CNF1.write(DEFAULT_TIMING.cnf1());
}

/// Brings the NodeStatus up to date. Call it once a second. Returns the lowest byte of the uptime.
#[inline(always)]
pub fn tick() -> u8 {
    // SAFETY: the pointer is to a variable, so its fields are valid. The loop ends at the last byte
    // of the uptime, which does not wrap in 136 years.
    unsafe {
        let first = (&raw mut (*information()).uptime_s).cast::<u8>();
        asm!("2: ld {byte}, X", "inc {byte}", "st X+, {byte}", "breq 2b",
            inout("X") first => _, byte = out(reg) _, options(nostack));
        (&raw mut (*information()).mode).write_volatile(MODE.read());
        first.read_volatile()
    }
}
