//! Requests of BeginFirmwareUpdate: which ones are accepted, and what the bootloader is told.
//! docs/update.md describes the hand-over.
//!
//! The node accepts a request only if the vehicle cannot be flying: it is not armed, and no command
//! was followed for two seconds. It answers, and some time later hands the request over to the
//! bootloader, which reads the file.

#![allow(
    clippy::useless_conversion,
    reason = "an address has 8 bits, or 16 with the feature outputs"
)]

use dronecan_wire::crc;

use super::bit_rate;
use super::parameters::Parameter;
use super::store::Eeprom;
use super::wire::Transfer;
use super::{Node, information};
use crate::handover::{BUS, BUS_LEN, CRC_START, PATH_LEN, REQUEST_LEN};

/// Time without a followed command before an update, in milliseconds.
pub const STILL_MS: u16 = 2000;

/// Errors in the response (DSDL 40.BeginFirmwareUpdate.uavcan).
const ERROR_OK: u8 = 0;
const ERROR_INVALID_MODE: u8 = 1;

/// The decision on a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Verdict {
    /// The board has another bootloader.
    NoLoader,
    /// The node will update itself.
    Accepted,
    /// The vehicle is armed, or the servo follows commands.
    InUse,
    /// The request to the bootloader has no room for the path.
    PathTooLong,
}

impl Verdict {
    /// The verdict with this number.
    pub const fn from_number(number: u8) -> Self {
        match number {
            1 => Self::Accepted,
            2 => Self::InUse,
            3 => Self::PathTooLong,
            _ => Self::NoLoader,
        }
    }

    /// The error in the response; the place and the length of its text in the information in flash.
    pub const fn response(self) -> (u8, u8, u8) {
        match self {
            Self::NoLoader => {
                (ERROR_INVALID_MODE, information::NO_UPDATE_AT, information::NO_UPDATE_LEN)
            }
            Self::Accepted => (ERROR_OK, information::NO_UPDATE_AT, 0),
            Self::InUse => (ERROR_INVALID_MODE, information::IN_USE_AT, information::IN_USE_LEN),
            Self::PathTooLong => {
                (ERROR_INVALID_MODE, information::PATH_TOO_LONG_AT, information::PATH_TOO_LONG_LEN)
            }
        }
    }
}

/// What the node knows of updates.
pub struct Update {
    /// True if the bootloader takes updates over the bus.
    pub has_loader: bool,
    /// The accepted request, as the bootloader takes it. Its CRC is wrong if there is none.
    request: [u8; REQUEST_LEN],
}

impl Update {
    /// No request.
    pub const fn new() -> Self {
        Self { has_loader: false, request: [0; REQUEST_LEN] }
    }
}

impl Default for Update {
    fn default() -> Self {
        Self::new()
    }
}

impl Node {
    /// Decides on a request, and keeps it if it is accepted.
    #[inline(always)]
    pub(super) fn begin_update(&mut self, request: &Transfer, now_ms: u16) -> Verdict {
        if !self.update.has_loader {
            return Verdict::NoLoader;
        }
        if self.actuators.is_armed() || self.actuators.has_followed_within(STILL_MS, now_ms) {
            return Verdict::InUse;
        }
        let path_len = request.len().wrapping_sub(1);
        if usize::from(path_len) > PATH_LEN {
            return Verdict::PathTooLong;
        }
        let &[server, ref path @ ..] = request.bytes();
        let record = &mut self.update.request;
        for (to, from) in record.iter_mut().zip(path).take(PATH_LEN) {
            *to = *from;
        }
        record[PATH_LEN] = path_len;
        // 0 is the sender itself.
        record[PATH_LEN + 1] = if server == 0 { request.source } else { server };
        let mut crc = CRC_START;
        for byte in record.iter_mut().take(REQUEST_LEN - 2) {
            crc = crc::add(crc, *byte);
        }
        [record[REQUEST_LEN - 2], record[REQUEST_LEN - 1]] = crc.to_be_bytes();
        Verdict::Accepted
    }

    /// Returns the accepted request, if there is one, and leaves node ID and bit rate in EEPROM for
    /// the bootloader. Takes up to 30 ms. The program must end then.
    pub fn hand_over(&self, eeprom: &mut impl Eeprom) -> Option<&[u8; REQUEST_LEN]> {
        if self.update.request[PATH_LEN + 1] == 0 {
            return None;
        }
        let timing = bit_rate::timing(self.parameters.get(Parameter::CanBaudrate) as u8);
        let mut record = [self.id, timing.cnf3(), timing.cnf2(), timing.cnf1(), 0, 0];
        let mut crc = CRC_START;
        for byte in record.iter().take(4) {
            crc = crc::add(crc, *byte);
        }
        [record[4], record[5]] = crc.to_be_bytes();
        for n in 0..BUS_LEN {
            wait(eeprom);
            if eeprom.read((BUS + n).into()) != record[usize::from(n)] {
                eeprom.begin_write((BUS + n).into(), record[usize::from(n)]);
            }
        }
        wait(eeprom);
        Some(&self.update.request)
    }
}

/// Waits until a write to the EEPROM has ended. The limit is many times the 3.4 ms that a write
/// takes, and ends the loop if the EEPROM stays busy.
fn wait(eeprom: &impl Eeprom) {
    let mut turns = u16::MAX;
    while eeprom.is_busy() && turns != 0 {
        turns -= 1;
    }
}
