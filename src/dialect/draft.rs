//! The UAVCAN draft of 2014, as the node of the thesis spoke it: the dialect of the preset
//! `thesis`.
//!
//! ```text
//! message: data_type[28:19] 2[18:17] source[16:10] frame_index[9:4] last_frame[3] transfer_id[2:0]
//! ```
//!
//! The draft has no priority and no tail byte. The node takes two messages of one frame each, the
//! command 760 and NodeStatus 550, and sends its NodeStatus and the measurement 761
//! (docs/dialects.md). (Source: libuavcan at the end of 2014, `uc_frame.cpp` and `transfer.hpp`.)

use dronecan_wire::{Rejection, Tail};
use mcp2515_ordered::{Frame, Pattern};

use super::Heard;
use crate::progmem::Progmem;
use crate::tables::condition::{Conditions, Level};
use crate::tables::kind::{DataTypes, Kind};
use crate::tables::types::DRAFT_NODE_STATUS;
use crate::tables::wire::{Segment, Transfer};

/// In the last byte of an identifier: the last frame of a transfer.
const LAST_FRAME: u8 = 1 << 3;
/// In the last byte of an identifier: the transfer ID, 0 to 7.
const TRANSFER_ID: u8 = 7;

/// Kind of transfer: a broadcast message.
const MESSAGE: u16 = 2;

/// The upper half of an identifier, with the source bit clear.
const fn upper(data_type: u16) -> u16 {
    data_type << 3 | MESSAGE << 1
}

/// The thesis's command.
const SERVO_COMMAND: u16 = 760;

/// The condition that is set while the node speaks this dialect.
pub const CONDITION: Conditions = Conditions::DRAFT;

/// True if requests pass the filters.
pub const HAS_REQUESTS: bool = false;

/// The filters and masks: both types of the thesis's node pass into both buffers. Every source
/// passes; the thesis's filters passed node 1 only.
pub const FILTERS: Option<[Pattern; 8]> = {
    const COMMAND: [u8; 4] = ((upper(SERVO_COMMAND) as u32) << 16 | 0x408).to_be_bytes();
    const STATUS: [u8; 4] = ((upper(DRAFT_NODE_STATUS.id) as u32) << 16 | 0x408).to_be_bytes();
    // Compares the data type, the kind of transfer, and the last-frame bit.
    const MASK: [u8; 4] = 0x1FFE_0008u32.to_be_bytes();
    let (command, status, mask) =
        (Pattern::filter(COMMAND), Pattern::filter(STATUS), Pattern::mask(MASK));
    Some([command, status, command, status, command, status, mask, mask])
};

/// The identifier of a frame of a message, without last-frame bit and transfer ID.
pub fn message_id(data_type: u16, source: u8) -> [u8; 4] {
    let [b0, b1] = upper(data_type).to_be_bytes();
    [b0, b1 | source >> 6, source << 2, 0]
}

/// Completes the only frame of a transfer: puts the last-frame bit and the transfer ID into the
/// identifier.
pub fn finish(frame: &mut Frame, tail: Tail) {
    let [.., last] = &mut frame.id;
    *last = *last & !TRANSFER_ID | tail.0 & TRANSFER_ID | LAST_FRAME;
}

/// Puts the payload of a NodeStatus: 28 bits of uptime; four bits, of which 0 is OK, 1
/// initialising, 2 warning, 3 critical; the vendor-specific status code.
pub fn put_status(
    uptime_sec: u32,
    level: Level,
    mode: u8,
    code: u16,
    put: &mut impl FnMut(u16),
) -> u8 {
    let [u0, u1, u2, u3] = uptime_sec.to_le_bytes();
    let status = match level {
        Level::Ok => mode,
        Level::Warning => 2,
        _ => 3,
    };
    put(u16::from_le_bytes([u0, u1]));
    put(u16::from_le_bytes([u2, u3 << 4 | status]));
    put(code);
    6
}

/// Reads the NodeStatus of another node: its uptime in seconds, and its health as DroneCAN v0
/// numbers it. `None` if its length is not one of those of 2014. (The thesis's has seven
/// bytes.)
pub fn read_status(status: &Transfer) -> Option<Heard> {
    let &[u0, u1, u2, u3, ..] = status.bytes();
    if !matches!(status.len(), 4 | 6 | 7 | 8) {
        return None;
    }
    // 0 is OK, 1 initialising, 2 warning, 3 critical, 15 offline.
    let level = match u3 & 15 {
        0 | 1 => Level::Ok,
        2 => Level::Warning,
        _ => Level::Critical,
    };
    Some(Heard { uptime: [u0, u1, u2, u3 >> 4], level: level as u8 })
}

/// The upper half of the identifier. Swapping the bytes here avoids a slow 16-bit swap in the AVR's
/// generated code.
fn upper_half(frame: &Frame) -> u16 {
    let [b0, b1, ..] = frame.id;
    u16::from_le_bytes([b1, b0])
}

/// Data type ID and source of a frame.
pub fn origin(frame: &Frame) -> (u16, u8) {
    let [_, b1, b2, _] = frame.id;
    (upper_half(frame) >> 3, (b1 << 6 | b2 >> 2) & 0x7F)
}

/// Data type ID of a message of this kind: this dialect has numbers of its own.
pub fn data_type(kind: Kind, _flash: impl Progmem<DataTypes>) -> u16 {
    if kind == Kind::ServoCommand { SERVO_COMMAND } else { DRAFT_NODE_STATUS.id }
}

/// Reads a frame for the node with this ID.
pub fn segment(frame: &Frame, node: u8) -> Result<Segment<'_>, Rejection> {
    if frame.is_foreign() {
        return Err(Rejection::Unknown);
    }
    let kind = match upper_half(frame) & !1 {
        kind if kind == const { upper(SERVO_COMMAND) } => Kind::ServoCommand,
        kind if kind == const { upper(DRAFT_NODE_STATUS.id) } => Kind::NodeStatus,
        _ => return Err(Rejection::Unknown),
    };
    let (_, source) = origin(frame);
    let [.., b2, b3] = frame.id;
    if source == 0 {
        return Err(Rejection::Anonymous);
    }
    if source == node {
        return Err(Rejection::OwnId);
    }
    // The frame index is 0, and the frame is the last one.
    if b2 & 0b11 | b3 & 0xF0 != 0 || b3 & LAST_FRAME == 0 {
        return Err(Rejection::Malformed);
    }
    let tail = Tail(b3 & TRANSFER_ID | Tail::START | Tail::END);
    Ok(Segment { kind, source, priority: 0, tail, payload: frame.data() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::golden::frames;

    #[test]
    fn a_frame_that_is_rejected_has_a_type_and_a_sender_all_the_same() {
        for (text, expected) in [
            ("17C40409 5A", (760, 1)),
            ("17C42419", (760, 9)),
            ("17C40008 00", (760, 0)),
            ("1135E00B EF CD AB 02", (550, 120)),
            ("1135FC0B EF", (550, 127)),
        ] {
            assert_eq!(origin(&frames(text)[0]), expected, "{text}");
        }
    }
}
