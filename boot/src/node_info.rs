//! What the node says about itself: NodeStatus, and the response of GetNodeInfo, which begins with
//! the same bytes (DSDL 341.NodeStatus and 1.GetNodeInfo). So both are sent from the same buffer.
//! The name is empty, which all clients accept.

use firmware::handover::{BUS, BUS_LEN, CRC_START};
use firmware::hardware::{CAN_CRYSTAL_HZ, HARDWARE_MAJOR, HARDWARE_MINOR};
use firmware::node::bit_rate::HIGHEST_RATE;
use mcp2515_ordered::BitTiming;

use crate::registers::{Register, idle};
use crate::{crc, eeprom};

/// Mode of the node, in its bits of NodeStatus. The health is zero, OK.
pub const MODE: Register = idle::GPIOR0;
pub const MAINTENANCE: u8 = 2 << 3;
pub const SOFTWARE_UPDATE: u8 = 3 << 3;

/// Address in EEPROM of the unique ID, which the program makes at its first start
/// (src/node/store.rs).
const UNIQUE_ID: u8 = 0x04;

/// Node ID without a record in EEPROM.
const DEFAULT_NODE_ID: u8 = 120;

/// Bit rate without a record in EEPROM: the highest one of the board.
const DEFAULT_TIMING: BitTiming = BitTiming::new(CAN_CRYSTAL_HZ, 125_000 << HIGHEST_RATE);

/// Room for the CRC, the payload of GetNodeInfo, and what follows in the EEPROM.
#[repr(C)]
pub struct Information {
    crc: [u8; 2],
    pub uptime_s: [u8; 4],
    mode: u8,
    vendor_status: [u8; 2],
    /// Nothing is known of the program.
    software_version: [u8; 15],
    hardware_version: [u8; 2],
    /// Here the image of the EEPROM begins.
    unique_id: [u8; 16],
    /// In the EEPROM, this and the following bytes are more of the record of the unique ID.
    certificate_len: u8,
    rest: [u8; (BUS - UNIQUE_ID) as usize - 17],
    pub node_id: u8,
    /// CNF3, CNF2 and CNF1 of the MCP2515: the bit rate.
    pub cnf: [u8; 3],
    bus_crc: [u8; 2],
}

impl Information {
    /// Length of a NodeStatus.
    pub const STATUS_LEN: u8 = 7;
    /// Length of a response of GetNodeInfo without a name.
    pub const LEN: u8 = 41;

    /// Reads the EEPROM, and writes what is not zero and does not change.
    #[inline(always)]
    pub fn set_up(&mut self) {
        let mut to = (&raw mut self.unique_id).cast::<u8>();
        let mut from = UNIQUE_ID;
        loop {
            // SAFETY: the fields from the unique ID on are as long as the image of the EEPROM.
            unsafe {
                to.write(eeprom::read(from));
                to = to.add(1);
            }
            from += 1;
            if from == BUS + BUS_LEN {
                break;
            }
        }
        self.certificate_len = 0;
        self.hardware_version = [HARDWARE_MAJOR, HARDWARE_MINOR];
        // SAFETY: the record ends the struct.
        if unsafe { crc::of(CRC_START, &raw const self.node_id, BUS_LEN.into()) } != 0 {
            self.node_id = DEFAULT_NODE_ID;
            self.cnf = [DEFAULT_TIMING.cnf3(), DEFAULT_TIMING.cnf2(), DEFAULT_TIMING.cnf1()];
        }
    }

    /// Brings the NodeStatus up to date. Call it once a second.
    #[inline(always)]
    pub fn tick(&mut self) {
        let mut byte = (&raw mut self.uptime_s).cast::<u8>();
        loop {
            // SAFETY: the loop ends at the last byte of the uptime, which does not wrap in 136
            // years.
            unsafe {
                let sum = (*byte).wrapping_add(1);
                byte.write_volatile(sum);
                byte = byte.add(1);
                if sum != 0 {
                    break;
                }
            }
        }
        self.mode = MODE.read();
    }

    /// The room for the CRC, and the payload behind it.
    #[inline(always)]
    pub fn buffer(&mut self) -> *mut u8 {
        (&raw mut *self).cast()
    }
}
