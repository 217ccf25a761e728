//! The UAVCAN draft of 2014, which older autopilots speak: its frames are made into frames of v0 that say the same.
//!
//! ```text
//! message: data_type_id[28:19] 2[18:17] source_node_id[16:10] frame_index[9:4] last_frame[3] transfer_id[2:0]
//! service: data_type_id[28:19] 0 or 1   the same
//! ```
//!
//! There is no priority and no tail byte, and the first byte of a service's frame is the destination. What the tail byte of
//! v0 says is in the identifier, so a frame can be eight bytes of payload, and nine with the tail byte. (libuavcan at the end
//! of 2014, `uc_frame.cpp` and `transfer.hpp`.)

use super::kind::Kind;
use super::wire::{END_OF_TRANSFER, REQUEST_NOT_RESPONSE, SERVICE_NOT_MESSAGE, START_OF_TRANSFER, TOGGLE};
use crate::can::Frame;
use crate::progmem::{DRAFT_KINDS, Progmem};

/// In the first byte of an identifier, above the priority: the frame was one of the draft.
pub const DRAFT: u8 = 1 << 6;

/// Beside it: if the frame is of a command, entries of three bytes.
pub const SHORT: u8 = 1 << 5;

/// In the last byte of an identifier.
pub const LAST_FRAME: u8 = 1 << 3;
/// In the last byte of an identifier: the number of the transfer, 0 to 7.
pub const TRANSFER_ID: u8 = 7;
/// In the second byte of an identifier: the highest bit of the sender.
const SOURCE: u8 = 1;

/// Upper bytes of an identifier, without the sender: ArrayCommand.
pub const ARRAY_COMMAND: [u8; 2] = upper(265, MESSAGE);
/// The same of the thesis's command.
pub const SERVO_COMMAND: [u8; 2] = upper(760, MESSAGE);
/// The same of its measurement.
pub const MEASUREMENT: [u8; 2] = upper(761, MESSAGE);
/// The same of NodeStatus.
pub const NODE_STATUS: [u8; 2] = upper(550, MESSAGE);
/// The same of a request to GetNodeInfo.
pub const GET_NODE_INFO: [u8; 2] = upper(551, REQUEST);
/// The same of the response.
pub const NODE_INFO: [u8; 2] = upper(551, RESPONSE);
/// The same of a request to RestartNode.
pub const RESTART_NODE: [u8; 2] = upper(560, REQUEST);
/// The same of the response.
pub const RESTARTED: [u8; 2] = upper(560, RESPONSE);

// Types of transfer; a message is one to everybody.
const RESPONSE: u16 = 0;
const REQUEST: u16 = 1;
const MESSAGE: u16 = 2;

/// By data type ID and type of transfer.
const fn upper(data_type: u16, transfer: u16) -> [u8; 2] {
    (data_type << 3 | transfer << 1).to_be_bytes()
}

/// Where the CRC of a GetNodeInfo response begins; nothing else that the node sends in the draft is longer than a frame.
pub const NODE_INFO_SEED: u16 = 0x14BB;

/// What the node takes: the upper bytes of the identifier without the sender, and the type in v0 (of a request its upper byte,
/// and [`SERVICE`]).
pub const PACKED: [u8; KINDS as usize * ENTRY_LEN as usize] = {
    let entries = [
        (ARRAY_COMMAND, Kind::ARRAY_COMMAND),
        (SERVO_COMMAND, Kind::SERVO_COMMAND),
        (NODE_STATUS, Kind::NODE_STATUS),
        (GET_NODE_INFO, Kind::GET_NODE_INFO),
        (RESTART_NODE, Kind::RESTART_NODE),
    ];
    let mut packed = [0; KINDS as usize * ENTRY_LEN as usize];
    let mut n = 0;
    while n < entries.len() {
        let ([b0, b1], kind) = entries[n];
        let [high, low] = kind.data_type().to_be_bytes();
        let entry = if kind.is_request() { [b0, b1, low, SERVICE] } else { [b0, b1, high, low] };
        let mut k = 0;
        while k < entry.len() {
            packed[4 * n + k] = entry[k];
            k += 1;
        }
        n += 1;
    }
    packed
};

/// Entries of [`PACKED`], and bytes of one.
const KINDS: u8 = 5;
const ENTRY_LEN: u8 = 4;
/// Behind the last one.
const END: u16 = DRAFT_KINDS + KINDS as u16 * ENTRY_LEN as u16;
/// The type of the draft's commands, in a command of v0.
const UNITLESS: u8 = 0;
/// No message that the draft has ends like this in v0.
const SERVICE: u8 = 0xFF;

/// No frame of the draft that the node takes has less in the second byte of its identifier.
const LOWEST: u8 = 0x34;

/// Makes a frame of v0 of one of the draft, if it is one that the node has a use for; otherwise leaves it as it is, and so one that has
/// been made already. Of a request the destination stays before the payload. A command for one actuator in a single frame, as most
/// are, gets the type that it has not in the draft, and is one of v0 then; other commands keep their form, which [`SHORT`] says.
#[inline(never)]
pub fn translate(frame: &mut Frame, flash: impl Progmem) {
    let [b0, b1, b2, b3] = frame.id;
    // What a frame of v0 that is of use never has.
    if b1 < LOWEST {
        return;
    }
    let mut at = DRAFT_KINDS;
    while flash.byte(at) != b0 || flash.byte(at.wrapping_add(1)) ^ b1 > SOURCE {
        at = at.wrapping_add(u16::from(ENTRY_LEN));
        if at == END {
            return;
        }
    }
    // The sender is in seven bits of both.
    let source = (u16::from_be_bytes([b1, b2]) >> 2) as u8 & !SERVICE_NOT_MESSAGE;
    let mut tail = b3 & TRANSFER_ID;
    // The index of the frame.
    if b2 & 0b11 | b3 & 0xF0 == 0 {
        tail |= START_OF_TRANSFER;
    }
    if b3 & LAST_FRAME != 0 {
        tail |= END_OF_TRANSFER;
    }
    if b3 & 1 << 4 != 0 {
        tail |= TOGGLE;
    }
    // The low byte tells the entries apart: the table is short.
    if at as u8 == DRAFT_KINDS as u8 && frame.len == 3 && tail >= START_OF_TRANSFER | END_OF_TRANSFER {
        let [high, low] = Kind::ARRAY_COMMAND.data_type().to_be_bytes();
        let [actuator, v0, v1, ..] = frame.data;
        frame.id = [DRAFT, high, low, source];
        [frame.data[0], frame.data[1], frame.data[2], frame.data[3], frame.data[4]] =
            [actuator, UNITLESS, v0, v1, tail];
        frame.len = 5;
        return;
    }
    let low = flash.byte(at.wrapping_add(3));
    frame.id = [DRAFT | SHORT, flash.byte(at.wrapping_add(2)), low, source];
    if low == SERVICE {
        frame.id[2] = REQUEST_NOT_RESPONSE | frame.data[0];
        frame.id[3] = source | SERVICE_NOT_MESSAGE;
    }
    frame.push(tail);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::golden::{frames, text};
    use crate::progmem::InMemory;

    fn translated(draft: &str) -> std::string::String {
        let mut frames = frames(draft);
        translate(&mut frames[0], InMemory);
        text(&frames)
    }

    #[test]
    fn messages_are_made_into_messages_with_a_tail_byte() {
        // NodeStatus of node 120, the thesis's command of node 1, a command for two actuators, and the second frame of a longer one.
        assert_eq!(translated("1135E00B EF CD AB 02 EF BE"), "60015578 EF CD AB 02 EF BE C3");
        assert_eq!(translated("17C40409 5A"), "60045701 5A C1");
        assert_eq!(translated("084C040A 01 00 38 02 00 BC"), "6003F201 01 00 38 02 00 BC C2");
        assert_eq!(translated("084C0412 01 00 38 02 00 BC 03 04"), "6003F201 01 00 38 02 00 BC 03 04 22");
        assert_eq!(translated("084C042A 00"), "6003F201 00 42");
    }

    #[test]
    fn a_command_for_one_actuator_takes_the_form_of_v0() {
        assert_eq!(translated("084C040A 01 00 38"), "4003F201 01 00 00 38 C2");
        // The first frame of more, and the last one of some.
        assert_eq!(translated("084C0402 01 00 38"), "6003F201 01 00 38 82");
        assert_eq!(translated("084C041A 01 00 38"), "6003F201 01 00 38 62");
    }

    #[test]
    fn what_has_been_made_a_frame_of_v0_stays_one() {
        for draft in ["1135E00B EF CD AB 02 EF BE", "084C040A 01 00 38", "084C042A 00", "113BFC0D 78"] {
            let once = translated(draft);
            assert_eq!(translated(&once), once);
        }
    }

    #[test]
    fn requests_keep_their_destination_byte() {
        assert_eq!(translated("113BFC0D 78"), "6001F8FF 78 C5");
        assert_eq!(translated("1183FC0E 78 1E 1B 55 CE AC"), "6005F8FF 78 1E 1B 55 CE AC C6");
    }

    #[test]
    fn a_request_without_a_destination_is_for_nobody_that_counts() {
        assert_eq!(translated("113BFC0D"), "600180FF C5");
    }

    #[test]
    fn everything_else_stays_as_it_is() {
        for frame in [
            "1801550A 0A 00 00 00 00 00 00 C1",
            "1003F20A 01 04 00 66 C0",
            "1139E005 7F 00",
            "17CDE008 17",
            "1139FC0D 78",
        ] {
            assert_eq!(translated(frame), text(&frames(frame)));
        }
    }
}
