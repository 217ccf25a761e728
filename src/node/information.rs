//! The constant part of a GetNodeInfo response (DSDL uavcan/protocol/1.GetNodeInfo.uavcan).

use crate::hardware::{HARDWARE_MAJOR, HARDWARE_MINOR, NODE_NAME as NAME};

/// How to update instead: the bootloaders of the Arduinos listen to the serial port only.
const NO_UPDATE: &str = "update over USB serial";

/// Why a request for an update is refused now.
#[cfg(feature = "update")]
const IN_USE: &str = "armed, or a command in the last 2 s";
/// Why a request for an update is refused always.
#[cfg(feature = "update")]
const PATH_TOO_LONG: &str = "path longer than 24 characters";

/// Bytes of software and hardware version in [`PACKED`].
pub const VERSIONS_LEN: u8 = 17;

/// Start of the text for BeginFirmwareUpdate in [`PACKED`].
pub const NO_UPDATE_AT: u8 = VERSIONS_LEN + 1 + NAME.len() as u8;
/// Length of the text at [`NO_UPDATE_AT`].
pub const NO_UPDATE_LEN: u8 = NO_UPDATE.len() as u8;

/// Bytes of a GetNodeInfo response: a NodeStatus, the versions, the unique ID, the length of the
/// certificate, the name.
pub const NODE_INFO_LEN: u8 = 7 + VERSIONS_LEN + 16 + 1 + NAME.len() as u8;

/// The table in flash: [`PACKED`].
pub struct Information;

/// Start of the text about the use of the node in [`PACKED`].
#[cfg(feature = "update")]
pub const IN_USE_AT: u8 = NO_UPDATE_AT + NO_UPDATE_LEN;
/// Length of the text at [`IN_USE_AT`].
#[cfg(feature = "update")]
pub const IN_USE_LEN: u8 = IN_USE.len() as u8;
/// Start of the text about the path in [`PACKED`].
#[cfg(feature = "update")]
pub const PATH_TOO_LONG_AT: u8 = IN_USE_AT + IN_USE_LEN;
/// Length of the text at [`PATH_TOO_LONG_AT`].
#[cfg(feature = "update")]
pub const PATH_TOO_LONG_LEN: u8 = PATH_TOO_LONG.len() as u8;

/// The texts for BeginFirmwareUpdate, one behind the other.
#[cfg(feature = "update")]
const REFUSALS: &[&str] = &[NO_UPDATE, IN_USE, PATH_TOO_LONG];
#[cfg(not(feature = "update"))]
const REFUSALS: &[&str] = &[NO_UPDATE];

const LEN: usize = {
    let (mut len, mut n) = (NO_UPDATE_AT as usize, 0);
    while n < REFUSALS.len() {
        len += REFUSALS[n].len();
        n += 1;
    }
    len
};

/// The bytes in the order of a GetNodeInfo response. Before the unique ID: software major, minor,
/// flags, commit, CRC; hardware major, minor. After the unique ID: the length of the certificate
/// (zero) and the name. Then the texts for BeginFirmwareUpdate.
pub const PACKED: [u8; LEN] = {
    let mut packed = [0; LEN];
    packed[0] = number(env!("CARGO_PKG_VERSION_MAJOR"), 10) as u8;
    packed[1] = number(env!("CARGO_PKG_VERSION_MINOR"), 10) as u8;
    // The commit is 0 if the sources are not under version control.
    let commit = number(env!("NODE_COMMIT"), 16);
    packed[2] = (commit != 0) as u8;
    [packed[3], packed[4], packed[5], packed[6]] = commit.to_le_bytes();
    packed[15] = HARDWARE_MAJOR;
    packed[16] = HARDWARE_MINOR;
    let mut at = VERSIONS_LEN as usize + 1;
    let mut n = 0;
    while n < NAME.len() {
        packed[at] = NAME.as_bytes()[n];
        at += 1;
        n += 1;
    }
    let mut text = 0;
    while text < REFUSALS.len() {
        n = 0;
        while n < REFUSALS[text].len() {
            packed[at] = REFUSALS[text].as_bytes()[n];
            at += 1;
            n += 1;
        }
        text += 1;
    }
    packed
};

const fn number(digits: &str, radix: u32) -> u32 {
    match u32::from_str_radix(digits, radix) {
        Ok(number) => number,
        Err(_) => panic!("a number that the build gives is not one"),
    }
}
