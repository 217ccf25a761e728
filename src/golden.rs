//! Reference data for the tests: frames that pydronecan 1.0.27 makes, and a second, simpler way to make and to parse transfers, written from the
//! specification (chapter 4) alone.

use std::string::String;
use std::vec::Vec;

use mcp2515_ordered::Frame;

use crate::image::InMemory;
use crate::node::condition::Conditions;
use crate::node::parameters::{Parameter, Parameters};

/// Frames of one transfer, written in hexadecimal: an identifier, then the data of each frame, separated by `|`.
pub fn frames(text: &str) -> Vec<Frame> {
    let (id, data) = text.split_once(' ').unwrap_or((text, ""));
    data.split('|').map(|data| frame(u32::from_str_radix(id, 16).unwrap(), &bytes(data))).collect()
}

/// Bytes written in hexadecimal.
pub fn bytes(text: &str) -> Vec<u8> {
    text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

/// A frame with this identifier and data.
pub fn frame(id: u32, data: &[u8]) -> Frame {
    let mut frame = Frame { id: id.to_be_bytes(), len: data.len() as u8, ..Frame::EMPTY };
    frame.data[..data.len()].copy_from_slice(data);
    frame
}

/// The identifier of a frame.
pub fn id(frame: &Frame) -> u32 {
    u32::from_be_bytes(frame.id)
}

/// Writes frames of one transfer in the format that [`frames`] reads.
pub fn text<'a>(frames: impl IntoIterator<Item = &'a Frame>) -> String {
    let mut text = String::new();
    let mut first = None;
    for frame in frames {
        match first {
            None => text = format!("{:08X}", id(frame)),
            Some(first) if first != frame.id => text += &format!(" | ANOTHER {:08X}", id(frame)),
            Some(_) => text += " |",
        }
        first = Some(frame.id);
        for byte in frame.data() {
            text += &format!(" {byte:02X}");
        }
    }
    text
}

/// CRC-16-CCITT-FALSE, a bit at a time, over the signature of the type and the payload.
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

/// The frames of a transfer.
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

/// The payload and the transfer ID of a transfer's frames. Panics if the frames do not follow the specification.
pub fn payload(signature: u64, frames: &[Frame]) -> (Vec<u8>, u8) {
    let mut all: Vec<u8> = frames.iter().flat_map(|frame| frame.data().split_last().unwrap().1.to_vec()).collect();
    let transfer_id = frames[0].data().last().unwrap() & 31;
    if frames.len() > 1 {
        all.drain(..2);
    }
    assert_eq!(text(frames), text(&transfer(id(&frames[0]), signature, transfer_id, &all)));
    (all, transfer_id)
}

/// The default parameters, changed by `values`.
pub fn parameters(values: &[(Parameter, i32)]) -> Parameters {
    let mut parameters = Parameters::new();
    parameters.set_defaults(InMemory);
    for &(parameter, value) in values {
        assert!(parameters.set(parameter as u8, value, InMemory), "{parameter:?} {value}");
    }
    parameters
}

pub const NODE_STATUS: u64 = 0x0F08_68D0_C1A7_C6F1;
pub const GET_NODE_INFO: u64 = 0xEE46_8A81_21C4_6A9E;
#[allow(dead_code, reason = "a build may not have it")]
pub const ALLOCATION: u64 = 0x0B2A_8126_20A1_1D40;
pub const GET_SET: u64 = 0xA7B6_22F9_39D1_A4D5;
#[allow(dead_code, reason = "a build may not have it")]
pub const GET_TRANSPORT_STATS: u64 = 0xBE6F_76A7_EC31_2B04;
#[allow(dead_code, reason = "a build may not have it")]
pub const BEGIN_FIRMWARE_UPDATE: u64 = 0xB7D7_25DF_7272_4126;
#[allow(dead_code, reason = "a build may not have it")]
pub const CAN_STATS: u64 = 0xCE08_0CAE_3CA3_3C75;
pub const ARRAY_COMMAND: u64 = 0xD8A7_4862_38EC_3AF3;
pub const ACTUATOR_STATUS: u64 = 0x5E9B_BA44_FAF1_EA04;
#[allow(dead_code, reason = "a build may not have it")]
pub const LIGHTS_COMMAND: u64 = 0x2031_D93C_8BDD_1EC4;

/// Every condition, in the order of the bits.
pub const CONDITIONS: [Conditions; 16] = [
    Conditions::RESET_WATCHDOG,
    Conditions::RESET_BROWN_OUT,
    Conditions::RESET_PANIC,
    Conditions::RESET_STRAY,
    Conditions::TRANSFER_ERRORS,
    Conditions::FRAMES_LOST,
    Conditions::ERROR_PASSIVE,
    Conditions::BUS_OFF,
    Conditions::GAVE_UP_SENDING,
    Conditions::CONTROLLER_LOST,
    Conditions::FAILSAFE,
    Conditions::TEMPERATURE,
    Conditions::SENSOR,
    Conditions::PARAMETERS_LOST,
    Conditions::DISARMED,
    Conditions::DRAFT,
];
