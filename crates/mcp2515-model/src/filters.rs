//! Acceptance: the buffer and the filter that accept a frame.
//!
//! A frame is compared for RXB0 (mask 0, filters 0 and 1) first, then for RXB1 (mask 1, filters 2
//! to 5). The matching filter with the lowest number is reported. For standard data frames the
//! extended part of mask and filter is compared with the first two data bytes.
//!
//! The datasheet leaves two points open: in the model a missing data byte compares as 0, and a
//! frame that is accepted with the filters off (RXM = 11) reports filter 0.
//!
//! Source: DS20001801J sections 4.2 and 4.5, Registers 4-1, 4-2 and 4-10 to 4-17. RXM = 01 and 10
//! are reserved there; the model gives them the meaning of the older revisions (standard only
//! without data byte filtering, extended only), and writing them is a violation.

use super::registers::{RXM0SIDH, sidl};
use can_model::{Frame, Id};

/// The buffer and filter that accept a frame, whether the buffer is free or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hit {
    /// 0 or 1.
    pub buffer: usize,
    /// Number of the filter, 0 to 5.
    pub filter: u8,
}

/// Receive buffer operating mode (RXM).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    Filtered,
    StandardOnly,
    ExtendedOnly,
    Any,
}

impl Mode {
    fn decode(rxm: u8) -> Mode {
        match rxm & 0b11 {
            0b00 => Mode::Filtered,
            0b01 => Mode::StandardOnly,
            0b10 => Mode::ExtendedOnly,
            _ => Mode::Any,
        }
    }
}

/// Finds the buffer for `frame`. `registers` is the register file, `rxm` has the RXM fields of
/// RXB0CTRL and RXB1CTRL.
pub fn accept(
    registers: &[u8; super::registers::SIZE],
    rxm: [u8; 2],
    frame: &Frame,
) -> Option<Hit> {
    const FILTERS: [std::ops::Range<u8>; 2] = [0..2, 2..6];
    for (buffer, filters) in FILTERS.into_iter().enumerate() {
        let mode = Mode::decode(rxm[buffer]);
        if mode == Mode::Any {
            return Some(Hit { buffer, filter: 0 });
        }
        let mask = quad(registers, RXM0SIDH + 4 * buffer as u8);
        for filter in filters {
            if matches(mode, mask, quad(registers, filter_address(filter)), frame) {
                return Some(Hit { buffer, filter });
            }
        }
    }
    None
}

/// Filters 0 to 2 are in column 0 of the map, 3 to 5 in column 1.
fn filter_address(filter: u8) -> u8 {
    filter % 3 * 4 + filter / 3 * 0x10
}

/// SIDH, SIDL, EID8, EID0 of a filter or mask.
fn quad(registers: &[u8; super::registers::SIZE], address: u8) -> [u8; 4] {
    let start = usize::from(address);
    [registers[start], registers[start + 1], registers[start + 2], registers[start + 3]]
}

fn matches(mode: Mode, mask: [u8; 4], filter: [u8; 4], frame: &Frame) -> bool {
    let (image, extended) = match frame.id {
        Id::Extended(_) => (pack_id(frame.id), true),
        Id::Standard(_) => {
            let [sidh, sidl, _, _] = pack_id(frame.id);
            let byte = |n: usize| frame.data().get(n).copied().unwrap_or(0);
            ([sidh, sidl, byte(0), byte(1)], false)
        }
    };
    let filter_is_extended = filter[1] & sidl::EXIDE != 0;
    let wanted = match mode {
        Mode::StandardOnly => !extended,
        Mode::ExtendedOnly => extended,
        _ => true,
    };
    if !wanted || extended != filter_is_extended {
        return false;
    }
    // The mask bytes that are compared. EID17 and EID16 have no data bit to compare with.
    let used = if extended {
        [0xFF, sidl::SID | sidl::EID, 0xFF, 0xFF]
    } else if frame.remote || mode == Mode::StandardOnly {
        [0xFF, sidl::SID, 0, 0]
    } else {
        [0xFF, sidl::SID, 0xFF, 0xFF]
    };
    (0..4).all(|n| (image[n] ^ filter[n]) & mask[n] & used[n] == 0)
}

/// An identifier as SIDH, SIDL, EID8, EID0, with EXIDE set for an extended one.
pub fn pack_id(id: Id) -> [u8; 4] {
    match id {
        Id::Standard(id) => [(id >> 3) as u8, (id << 5) as u8, 0, 0],
        Id::Extended(id) => [
            (id >> 21) as u8,
            (id >> 13) as u8 & sidl::SID | sidl::EXIDE | (id >> 16) as u8 & sidl::EID,
            (id >> 8) as u8,
            id as u8,
        ],
    }
}

/// The identifier in SIDH, SIDL, EID8, EID0.
pub fn unpack_id([sidh, sidl, eid8, eid0]: [u8; 4]) -> Id {
    let standard = u16::from(sidh) << 3 | u16::from(sidl >> 5);
    if sidl & sidl::EXIDE == 0 {
        return Id::Standard(standard);
    }
    let low = u32::from(sidl & sidl::EID) << 16 | u32::from(eid8) << 8 | u32::from(eid0);
    Id::Extended(u32::from(standard) << 18 | low)
}
