//! The UAVCAN draft of 2014, which older autopilots speak: reads its frames, and defines the
//! identifiers of the frames that the node sends.
//!
//! ```text
//! message: data_type[28:19] 2[18:17]          source[16:10] frame_index[9:4] last_frame[3] transfer_id[2:0]
//! service: data_type[28:19] 0 or 1[18:17]     the same; 1 is a request
//! ```
//!
//! The draft has no priority and no tail byte. The first byte of each frame of a service is the
//! destination. (Source: libuavcan at the end of 2014, `uc_frame.cpp` and `transfer.hpp`.)

use dronecan_wire::{Rejection, Tail};
use mcp2515_ordered::Frame;

use super::kind::Kind;
use super::wire::Segment;

/// Bit of [`Segment::priority`], above the priority: set for a frame of the draft.
pub const IS_DRAFT: u8 = 1 << 6;

/// In the last byte of an identifier: the last frame of a transfer.
const LAST_FRAME: u8 = 1 << 3;
/// In the last byte of an identifier: the transfer ID, 0 to 7.
const TRANSFER_ID: u8 = 7;
/// In the last byte of an identifier: shift of the lower bits of the frame index.
const INDEX_SHIFT: u8 = 4;

/// Kinds of transfer.
const RESPONSE: u16 = 0;
const REQUEST: u16 = 1;
const MESSAGE: u16 = 2;

/// The upper half of an identifier, with the source bit clear.
const fn upper(data_type: u16, transfer: u16) -> u16 {
    data_type << 3 | transfer << 1
}

const ARRAY_COMMAND: u16 = upper(265, MESSAGE);
const SERVO_COMMAND: u16 = upper(760, MESSAGE);
const NODE_STATUS: u16 = upper(550, MESSAGE);
const GET_NODE_INFO: u16 = upper(551, REQUEST);
const RESTART_NODE: u16 = upper(560, REQUEST);

/// Identifiers of the transfers that the node sends: the upper half, with the source bit clear.
pub mod sent {
    use super::{MESSAGE, RESPONSE, upper};
    /// NodeStatus.
    pub const NODE_STATUS: u16 = upper(550, MESSAGE);
    /// The thesis's measurement.
    pub const MEASUREMENT: u16 = upper(761, MESSAGE);
    /// The response to GetNodeInfo.
    pub const NODE_INFO: u16 = upper(551, RESPONSE);
    /// The response to RestartNode.
    pub const RESTARTED: u16 = upper(560, RESPONSE);
}

/// The initial CRC of a GetNodeInfo response. No other transfer that the node sends in the draft
/// needs more than one frame.
pub const NODE_INFO_SEED: u16 = 0x14BB;

/// The identifier of a frame from node `source`, without frame index, last-frame bit and transfer
/// ID.
#[inline(never)]
pub fn id(upper: u16, source: u8) -> [u8; 4] {
    let [b0, b1] = upper.to_be_bytes();
    [b0, b1 | source >> 6, source << 2, 0]
}

/// Puts the frame index, the last-frame bit and the transfer ID into an identifier. `index` is less
/// than 16: no transfer of the node has more frames.
#[inline(always)]
pub fn set_place(id: &mut [u8; 4], index: u8, tail: Tail) {
    let [.., last] = id;
    *last =
        index << INDEX_SHIFT | tail.0 & TRANSFER_ID | if tail.is_end() { LAST_FRAME } else { 0 };
}

/// The kind of transfer that a frame of the draft belongs to.
#[inline(always)]
fn kind(frame: &Frame) -> Kind {
    match upper_half(frame) & !1 {
        SERVO_COMMAND => Kind::ServoCommand,
        NODE_STATUS => Kind::NodeStatus,
        ARRAY_COMMAND => Kind::DraftCommand,
        GET_NODE_INFO => Kind::GetNodeInfo,
        RESTART_NODE => Kind::RestartNode,
        _ => Kind::Unknown,
    }
}

/// The upper half of the identifier. Swapping the bytes here avoids a slow 16-bit swap in the AVR's
/// generated code.
#[inline(always)]
fn upper_half(frame: &Frame) -> u16 {
    let [b0, b1, ..] = frame.id;
    u16::from_le_bytes([b1, b0])
}

#[inline(always)]
fn source(frame: &Frame) -> u8 {
    let [_, b1, b2, _] = frame.id;
    (b1 << 6 | b2 >> 2) & 0x7F
}

/// Data type ID of a frame of the draft.
#[inline(always)]
pub fn data_type(frame: &Frame) -> u16 {
    upper_half(frame) >> 3
}

/// Data type ID and source of a frame of the draft. `None` if the node does not take its type.
#[inline(never)]
pub fn origin(frame: &Frame) -> Option<(u16, u8)> {
    (kind(frame) != Kind::Unknown).then(|| (data_type(frame), source(frame)))
}

/// Reads a frame of the draft for the node with this ID (0 if it has none). Returns
/// [`Rejection::Unknown`] if the node does not take its type; the frame may then be one of v0.
#[inline(always)]
pub fn segment(frame: &Frame, node: u8) -> Result<Segment<'_>, Rejection> {
    if frame.is_foreign() {
        return Err(Rejection::Unknown);
    }
    let kind = kind(frame);
    if kind == Kind::Unknown {
        return Err(Rejection::Unknown);
    }
    let source = source(frame);
    let [.., b2, b3] = frame.id;
    if source == 0 {
        return Err(Rejection::Anonymous);
    }
    if source == node {
        return Err(Rejection::OwnId);
    }
    let mut payload = frame.data();
    if kind.is_request() {
        match payload.split_first() {
            Some((&destination, rest)) if destination == node => payload = rest,
            _ => return Err(Rejection::Unknown),
        }
    }
    let mut tail = b3 & TRANSFER_ID;
    // The frame index is 0.
    if b2 & 0b11 | b3 & 0xF0 == 0 {
        tail |= Tail::START;
    }
    if b3 & LAST_FRAME != 0 {
        tail |= Tail::END;
    }
    if b3 & 1 << INDEX_SHIFT != 0 {
        tail |= Tail::TOGGLE;
    }
    Ok(Segment { kind, source, priority: IS_DRAFT, tail: Tail(tail), payload })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::golden::{bytes, frames};

    fn read(text: &str) -> Result<(Kind, u8, u8, Vec<u8>), Rejection> {
        let frames = frames(text);
        segment(&frames[0], 120).map(|s| (s.kind, s.source, s.tail.0, s.payload.to_vec()))
    }

    #[test]
    fn messages_are_read_with_their_place_in_the_transfer() {
        // NodeStatus from node 119 (120 is this node's own ID), the thesis's command from node 1, a
        // command for two actuators, and parts of longer commands.
        for (text, kind, source, tail, payload) in [
            ("1135DC0B EF CD AB 02 EF BE", Kind::NodeStatus, 119, 0xC3, "EF CD AB 02 EF BE"),
            ("17C40409 5A", Kind::ServoCommand, 1, 0xC1, "5A"),
            ("084C040A 01 00 38 02 00 BC", Kind::DraftCommand, 1, 0xC2, "01 00 38 02 00 BC"),
            (
                "084C0412 01 00 38 02 00 BC 03 04",
                Kind::DraftCommand,
                1,
                0x22,
                "01 00 38 02 00 BC 03 04",
            ),
            ("084C0402 01 00 38", Kind::DraftCommand, 1, 0x82, "01 00 38"),
            ("084C042A 00", Kind::DraftCommand, 1, 0x42, "00"),
        ] {
            assert_eq!(read(text), Ok((kind, source, tail, bytes(payload))), "{text}");
        }
    }

    #[test]
    fn requests_are_read_without_their_destination() {
        assert_eq!(read("113BFC0D 78"), Ok((Kind::GetNodeInfo, 127, 0xC5, vec![])));
        assert_eq!(
            read("1183FC0E 78 1E 1B 55 CE AC"),
            Ok((Kind::RestartNode, 127, 0xC6, bytes("1E 1B 55 CE AC")))
        );
    }

    #[test]
    fn requests_to_others_and_without_a_destination_are_unknown() {
        for text in ["113BFC0D 77", "113BFC0D"] {
            assert_eq!(read(text), Err(Rejection::Unknown), "{text}");
        }
    }

    #[test]
    fn a_frame_with_this_nodes_id_or_with_none_is_rejected() {
        assert_eq!(read("1135E00B EF CD AB 02"), Err(Rejection::OwnId));
        assert_eq!(read("1134000B EF CD AB 02"), Err(Rejection::Anonymous));
    }

    #[test]
    fn a_frame_that_is_rejected_has_a_type_and_a_sender_all_the_same() {
        for (text, expected) in [
            ("17C40409 5A", Some((760, 1))),
            ("17C42419", Some((760, 9))),
            ("17C40008 00", Some((760, 0))),
            ("1135E00B EF CD AB 02", Some((550, 120))),
            ("1135FC0B EF", Some((550, 127))),
            ("1003F20A 01 04 00 66 C0", None),
        ] {
            assert_eq!(origin(&frames(text)[0]), expected, "{text}");
        }
    }

    #[test]
    fn frames_of_v0_and_of_other_types_are_unknown() {
        for text in [
            "1801550A 0A 00 00 00 00 00 00 C1",
            "1003F20A 01 04 00 66 C0",
            "1139E005 7F 00",
            "17CDE008 17",
            "1139FC0D 78",
        ] {
            assert_eq!(read(text), Err(Rejection::Unknown), "{text}");
        }
    }
}
