//! Reference data for tests, also for those of programs that use this crate: frames that pydronecan
//! 1.0.27 made, and a second, simpler implementation of transfers, written from the specification
//! (chapter 4) alone.

use std::format;
use std::string::String;
use std::vec;
use std::vec::Vec;

/// A frame with an extended identifier.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// The identifier.
    pub id: u32,
    /// The data, at most 8 bytes.
    pub data: Vec<u8>,
}

/// Reads the frames of one transfer: the identifier, then the data of each frame with `|` between
/// the frames, all in hexadecimal.
pub fn frames(text: &str) -> Vec<Frame> {
    let (id, data) = text.split_once(' ').unwrap_or((text, ""));
    data.split('|').map(|data| frame(u32::from_str_radix(id, 16).unwrap(), &bytes(data))).collect()
}

/// Reads bytes in hexadecimal.
pub fn bytes(text: &str) -> Vec<u8> {
    text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

/// Makes a frame.
pub fn frame(id: u32, data: &[u8]) -> Frame {
    Frame { id, data: data.to_vec() }
}

/// Writes the frames of one transfer in the form that [`frames`] reads.
pub fn text<'a>(frames: impl IntoIterator<Item = &'a Frame>) -> String {
    let mut text = String::new();
    let mut first = None;
    for frame in frames {
        match first {
            None => text = format!("{:08X}", frame.id),
            Some(first) if first != frame.id => text += &format!(" | ANOTHER {:08X}", frame.id),
            Some(_) => text += " |",
        }
        first = Some(frame.id);
        for byte in &frame.data {
            text += &format!(" {byte:02X}");
        }
    }
    text
}

/// Computes CRC-16-CCITT-FALSE, a bit at a time, over the signature of the type and the payload.
pub fn crc(signature: u64, payload: &[u8]) -> u16 {
    signature.to_le_bytes().iter().chain(payload).fold(0xFFFF, |crc, &byte| add(crc, byte))
}

fn add(mut crc: u16, byte: u8) -> u16 {
    crc ^= u16::from(byte) << 8;
    for _ in 0..8 {
        crc = crc << 1 ^ if crc & 0x8000 != 0 { 0x1021 } else { 0 };
    }
    crc
}

/// Makes the frames of a transfer.
pub fn transfer(id: u32, signature: u64, transfer_id: u8, payload: &[u8]) -> Vec<Frame> {
    if payload.len() <= 7 {
        return vec![frame(id, &[payload, &[0xC0 | transfer_id]].concat())];
    }
    let all = [&crc(signature, payload).to_le_bytes(), payload].concat();
    let last = (all.len() - 1) / 7;
    let with_tail = |(n, part): (usize, &[u8])| {
        let toggle = (n as u8 & 1) << 5;
        let start = if n == 0 { 0x80 } else { 0 };
        let end = if n == last { 0x40 } else { 0 };
        frame(id, &[part, &[start | end | toggle | transfer_id]].concat())
    };
    all.chunks(7).enumerate().map(with_tail).collect()
}

/// Returns the payload and the transfer ID of a transfer. Asserts that its frames are as the
/// specification has them.
pub fn payload(signature: u64, frames: &[Frame]) -> (Vec<u8>, u8) {
    let mut all: Vec<u8> =
        frames.iter().flat_map(|frame| frame.data.split_last().unwrap().1.to_vec()).collect();
    let transfer_id = frames[0].data.last().unwrap() & 31;
    if frames.len() > 1 {
        all.drain(..2);
    }
    assert_eq!(text(frames), text(&transfer(frames[0].id, signature, transfer_id, &all)));
    (all, transfer_id)
}

/// Signature of uavcan.protocol.NodeStatus.
pub const NODE_STATUS: u64 = 0x0F08_68D0_C1A7_C6F1;
/// Signature of uavcan.protocol.GetNodeInfo.
pub const GET_NODE_INFO: u64 = 0xEE46_8A81_21C4_6A9E;
/// Signature of uavcan.protocol.dynamic_node_id.Allocation.
pub const ALLOCATION: u64 = 0x0B2A_8126_20A1_1D40;
/// Signature of uavcan.protocol.param.GetSet.
pub const GET_SET: u64 = 0xA7B6_22F9_39D1_A4D5;
/// Signature of uavcan.protocol.GetTransportStats.
pub const GET_TRANSPORT_STATS: u64 = 0xBE6F_76A7_EC31_2B04;
/// Signature of debug.LogMessage.
pub const LOG_MESSAGE: u64 = 0xD654_A48E_0C04_9D75;
/// Signature of uavcan.protocol.file.BeginFirmwareUpdate.
pub const BEGIN_FIRMWARE_UPDATE: u64 = 0xB7D7_25DF_7272_4126;
/// Signature of dronecan.protocol.CanStats.
pub const CAN_STATS: u64 = 0xCE08_0CAE_3CA3_3C75;
/// Signature of uavcan.equipment.actuator.ArrayCommand.
pub const ARRAY_COMMAND: u64 = 0xD8A7_4862_38EC_3AF3;
/// Signature of uavcan.equipment.actuator.Status.
pub const ACTUATOR_STATUS: u64 = 0x5E9B_BA44_FAF1_EA04;
/// Signature of uavcan.equipment.esc.RawCommand.
pub const RAW_COMMAND: u64 = 0x217F_5C87_D7EC_951D;
/// Signature of uavcan.equipment.indication.LightsCommand.
pub const LIGHTS_COMMAND: u64 = 0x2031_D93C_8BDD_1EC4;

/// Transfers that pydronecan made, with the signatures of their types.
pub const TRANSFERS: &[(u64, &str)] = &[
    (ARRAY_COMMAND, "1003F20A 01 00 00 38 C7"),
    (ARRAY_COMMAND, "1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 65 68"),
    (ACTUATOR_STATUS, "1803F32A 67 C0 01 00 34 FF 7F 81 | FF 7F 7F 61"),
    (LIGHTS_COMMAND, "1804390A 68 6B 07 00 1F 00 05 82 | 40 08 FF FF 62"),
    (ALLOCATION, "1E00017F 8A 68 FA 00 01 02 03 82 | 04 05 06 07 08 09 0A 22 | 0B 0C 0D 0E 0F 42"),
    (GET_SET, "1E0BAAFF C5 16 00 01 2A 00 00 81 | 00 00 00 00 00 43 41 21 | 4E 5F 4E 4F 44 45 41"),
    (
        BEGIN_FIRMWARE_UPDATE,
        "1E287FF8 07 C4 01 75 70 64 61 89 | 74 65 20 6F 76 65 72 29 | 20 55 53 42 20 73 65 09 | \
         72 69 61 6C 69",
    ),
    (
        CAN_STATS,
        "18015778 73 A5 00 01 00 02 00 80 | 02 00 03 00 04 00 05 20 | 00 06 00 07 00 08 00 00 | \
         08 00 09 00 0A 00 60",
    ),
    (
        GET_TRANSPORT_STATS,
        "1E047FF8 8C B1 01 00 00 00 00 85 | 00 02 00 00 00 00 00 25 | 03 00 00 00 00 00 34 05 | \
         12 00 00 00 00 78 56 25 | 00 00 00 00 BC 9A 00 05 | 00 00 00 65",
    ),
    (NODE_STATUS, "1801552A 78 56 34 12 40 EF BE C5"),
    (0, "1804562A 01 00 A9 5C 00 C2"),
    (0, "1E0A7FF8 00 00 00 00 00 00 80 C4"),
    (0, "1E057FF8 80 C6"),
    (GET_SET, "1E0B7FF8 00 00 00 00 C2"),
    (
        GET_SET,
        "1E0B7FF8 47 0A 01 2A 00 00 00 81 | 00 00 00 00 01 78 00 21 | 00 00 00 00 00 00 01 01 | \
         7D 00 00 00 00 00 00 21 | 00 01 00 00 00 00 00 01 | 00 00 00 43 41 4E 5F 21 | 4E 4F 44 \
         45 41",
    ),
];

#[cfg(test)]
#[test]
fn the_second_implementation_agrees_with_pydronecan() {
    for &(signature, golden) in TRANSFERS {
        // Asserts that the frames agree.
        payload(signature, &frames(golden));
        assert_eq!(text(&frames(golden)), golden.split_whitespace().collect::<Vec<_>>().join(" "));
    }
}
