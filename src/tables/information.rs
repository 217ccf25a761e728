//! The constant part of a GetNodeInfo response (DSDL uavcan/protocol/1.GetNodeInfo.uavcan).

use crate::handover::{
    DESCRIPTOR_LEN, HEADER_LEN, IMAGE_CRC, IMAGE_CRC_LEN, SOFTWARE_VERSION_LEN, TAKES_NO_UPDATES,
};
use crate::hardware::{HARDWARE_MAJOR, HARDWARE_MINOR, NODE_NAME as NAME};

/// Bytes of software and hardware version in a GetNodeInfo response.
pub const VERSIONS_LEN: u8 = 17;

/// True if the program takes updates over the bus. It has an application descriptor, by which file
/// servers know its file.
const HAS_DESCRIPTOR: bool = cfg!(feature = "update");
/// Index of the CRC of the image among the versions.
const CRC_AT: u8 = SOFTWARE_VERSION_LEN as u8;
/// Index of the hardware version among the versions, behind the CRC of the image.
pub const HARDWARE_AT: u8 = CRC_AT + IMAGE_CRC_LEN as u8;
/// Bytes of the descriptor before and behind the CRC of the image.
const BEFORE_CRC: u8 = if HAS_DESCRIPTOR { IMAGE_CRC as u8 } else { 0 };
const BEHIND_CRC: u8 =
    if HAS_DESCRIPTOR { (DESCRIPTOR_LEN - IMAGE_CRC - IMAGE_CRC_LEN) as u8 } else { 0 };

/// Signature of the application descriptor, of ArduPilot and PX4.
const SIGNATURE: [u8; IMAGE_CRC] = [0x40, 0xA2, 0xE4, 0xF1, 0x64, 0x68, 0x91, 0x06];

/// Index of the name in [`PACKED`].
const NAME_AT: u8 = VERSIONS_LEN + BEFORE_CRC + BEHIND_CRC + 1;

/// Index in [`PACKED`] of byte `at` of the versions, the length of the certificate, and the name.
pub const fn index_of(mut at: u8) -> u8 {
    if HAS_DESCRIPTOR && at >= CRC_AT {
        at += BEFORE_CRC;
        if at >= HARDWARE_AT + BEFORE_CRC {
            at += BEHIND_CRC;
        }
    }
    at
}

/// Bytes of a GetNodeInfo response: a NodeStatus, the versions, the unique ID, the length of the
/// certificate, the name.
pub const NODE_INFO_LEN: u8 = 7 + VERSIONS_LEN + 16 + 1 + NAME.len() as u8;

/// The texts of the responses to BeginFirmwareUpdate, in the order of
/// [`Verdict`](crate::parts::update::Verdict). Without updates over the bus there is an empty one.
const TEXTS: &[&str] = if cfg!(feature = "update") {
    &[
        "update over USB serial",
        "",
        "armed, or a command in the last 2 s",
        "path longer than 24 characters",
    ]
} else {
    &[""]
};

/// The table in flash: [`PACKED`].
pub struct Information;

/// Place and length in [`PACKED`] of one of the texts for BeginFirmwareUpdate.
pub const fn text(n: usize) -> (u8, u8) {
    let (mut at, mut text) = (NAME_AT as usize + NAME.len(), 0);
    while text < n {
        at += TEXTS[text].len();
        text += 1;
    }
    (at as u8, TEXTS[n].len() as u8)
}

const LEN: usize = {
    let (at, len) = text(TEXTS.len() - 1);
    at as usize + len as usize
};

/// The bytes in the order of a GetNodeInfo response. Before the unique ID: software major, minor,
/// flags, commit, CRC; hardware major, minor. After the unique ID: the length of the certificate
/// (zero) and the name. Then the texts for BeginFirmwareUpdate. The CRC is that of the application
/// descriptor, which is in its place (see [`crate::handover`]).
pub const PACKED: [u8; LEN] = {
    let mut packed = [0; LEN];
    let versions = [
        number(env!("CARGO_PKG_VERSION_MAJOR"), 10) as u8,
        number(env!("CARGO_PKG_VERSION_MINOR"), 10) as u8,
    ];
    [packed[0], packed[1]] = versions;
    // The commit is 0 if the sources are not under version control.
    let commit = number(env!("NODE_COMMIT"), 16).to_le_bytes();
    packed[2] = (u32::from_le_bytes(commit) != 0) as u8;
    [packed[3], packed[4], packed[5], packed[6]] = commit;
    if HAS_DESCRIPTOR {
        let descriptor = CRC_AT as usize;
        let mut n = 0;
        while n < SIGNATURE.len() {
            packed[descriptor + n] = SIGNATURE[n];
            n += 1;
        }
        // Behind the CRC and the length of the image, which scripts/image writes.
        let rest = descriptor + 20;
        [packed[rest], packed[rest + 1], packed[rest + 2], packed[rest + 3]] = commit;
        [packed[rest + 4], packed[rest + 5]] = versions;
        [packed[rest + 6], packed[rest + 7]] = [HARDWARE_MINOR, HARDWARE_MAJOR];
    }
    let hardware = index_of(HARDWARE_AT) as usize;
    let mark = if HAS_DESCRIPTOR { 0 } else { TAKES_NO_UPDATES };
    [packed[hardware], packed[hardware + 1]] = [HARDWARE_MAJOR | mark, HARDWARE_MINOR];
    let mut at = NAME_AT as usize;
    let mut n = 0;
    while n < NAME.len() {
        packed[at] = NAME.as_bytes()[n];
        at += 1;
        n += 1;
    }
    let mut text = 0;
    while text < TEXTS.len() {
        n = 0;
        while n < TEXTS[text].len() {
            packed[at] = TEXTS[text].as_bytes()[n];
            at += 1;
            n += 1;
        }
        text += 1;
    }
    packed
};

/// The header of this program, without what scripts/image writes.
pub const HEADER: [u8; HEADER_LEN] =
    [HARDWARE_MAJOR, HARDWARE_MINOR, PACKED[0], PACKED[1], 0, 0, 0, 0];

const fn number(digits: &str, radix: u32) -> u32 {
    match u32::from_str_radix(digits, radix) {
        Ok(number) => number,
        Err(_) => panic!("a number that the build gives is not one"),
    }
}
