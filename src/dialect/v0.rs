//! DroneCAN v0: the dialect of every build but that of the preset `thesis`.

use dronecan_wire::{Id, Rejection, Tail};
use mcp2515_ordered::{Frame, Pattern};

use super::Heard;
use crate::progmem::Progmem;
use crate::tables::condition::{Conditions, Level};
use crate::tables::kind::{DataTypes, Kind};
use crate::tables::wire::{Segment, Transfer};

/// No condition is set.
pub const CONDITION: Conditions = Conditions::NONE;

/// True: requests pass the filters.
pub const HAS_REQUESTS: bool = true;

/// `None`: the filters follow from the table of received types.
pub const FILTERS: Option<[Pattern; 8]> = None;

/// Priority of periodic messages. ArduPilot's own peripherals use the same.
const PRIORITY_LOW: u8 = 24;

/// The identifier of a message.
pub fn message_id(data_type: u16, source: u8) -> [u8; 4] {
    Id::message(PRIORITY_LOW, data_type, source).to_bytes()
}

/// Completes a frame: adds the tail byte.
pub fn finish(frame: &mut Frame, tail: Tail) {
    frame.push(tail.0);
}

/// Puts the payload of a NodeStatus (DSDL uavcan/protocol/341.NodeStatus.uavcan). Returns its
/// length in bytes; the last of the bytes that it puts is not one of them.
#[inline(always)]
pub fn put_status(
    uptime_sec: u32,
    level: Level,
    mode: u8,
    code: u16,
    put: &mut impl FnMut(u16),
) -> u8 {
    let [u0, u1, u2, u3] = uptime_sec.to_le_bytes();
    let [code_low, code_high] = code.to_le_bytes();
    put(u16::from_le_bytes([u0, u1]));
    put(u16::from_le_bytes([u2, u3]));
    put(u16::from_le_bytes([(level as u8) << 6 | mode << 3, code_low]));
    put(u16::from(code_high));
    7
}

/// Reads the NodeStatus of another node. `None` if its length is wrong.
#[inline(always)]
pub fn read_status(status: &Transfer) -> Option<Heard> {
    let &[u0, u1, u2, u3, state, ..] = status.bytes();
    if status.len() != 7 {
        return None;
    }
    Some(Heard { uptime: [u0, u1, u2, u3], level: state >> 6 })
}

/// Data type ID and source of a frame.
pub fn origin(frame: &Frame) -> (u16, u8) {
    let id = Id::from_bytes(frame.id);
    (id.data_type(), id.source())
}

/// Data type ID of a message of this kind.
pub fn data_type(kind: Kind, flash: impl Progmem<DataTypes>) -> u16 {
    kind.data_type(flash)
}

/// Reads a frame for the node with this ID, or 0 if it has none.
#[inline(always)]
pub fn segment(frame: &Frame, node: u8) -> Result<Segment<'_>, Rejection> {
    if frame.is_foreign() {
        return Err(Rejection::Unknown);
    }
    Segment::read(Id::from_bytes(frame.id), frame.data(), node)
}
