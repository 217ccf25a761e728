//! Requests of BeginFirmwareUpdate: which ones are accepted, and what the bootloader is told.
//! docs/update.md describes the hand-over.
//!
//! The node accepts a request only if the vehicle cannot be flying: it is not armed, and no command
//! was followed for two to three seconds. It answers, and some time later hands the request over to
//! the bootloader, which reads the file.

use dronecan_wire::crc;

use crate::eeprom::{Address, Eeprom};
use crate::handover::{BUS, BUS_LEN, CRC_START, PATH_LEN, REQUEST_LEN, TAKES_NO_UPDATES};
use crate::tables::parameters::{Parameter, Parameters};
use crate::tables::wire::Transfer;
use crate::tables::{bit_rate, information};

/// True: the node takes updates over the bus.
pub const IS_THERE: bool = true;

/// True: a response says why a request is refused.
pub const HAS_TEXTS: bool = true;

/// The decision on a request. Its number is that of its text.
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
    /// The number of [`Verdict::InUse`].
    pub const IN_USE: u8 = Self::InUse as u8;

    /// True if a verdict with this number restarts the node.
    pub fn is_accepted(number: u8) -> bool {
        number == Self::Accepted as u8
    }

    /// The place and the length of the text for a verdict with this number in the
    /// [`information`] in flash.
    pub fn text(number: u8) -> (u8, u8) {
        match number {
            1 => const { information::text(Self::Accepted as usize) },
            2 => const { information::text(Self::InUse as usize) },
            3 => const { information::text(Self::PathTooLong as usize) },
            _ => const { information::text(Self::NoLoader as usize) },
        }
    }
}

/// What the node knows of updates.
pub struct Update {
    /// True if the bootloader takes updates over the bus.
    has_loader: bool,
    /// True if the record of the bus in EEPROM may not be that of the parameters.
    is_record_due: bool,
    /// The client knows that its request is accepted.
    is_answered: bool,
    /// The accepted request, as the bootloader takes it. Its CRC is wrong if there is none.
    request: [u8; REQUEST_LEN],
}

impl Update {
    /// No request.
    pub const fn new() -> Self {
        Self {
            has_loader: false,
            is_record_due: false,
            is_answered: false,
            request: [0; REQUEST_LEN],
        }
    }

    /// Notes if the bootloader takes updates over the bus.
    pub fn start(&mut self, has_loader: bool) {
        self.has_loader = has_loader;
        self.is_record_due = has_loader;
    }

    /// What is added to the major hardware version.
    pub fn mark(&self) -> u8 {
        if self.has_loader { 0 } else { TAKES_NO_UPDATES }
    }

    /// Notes that the parameters were saved.
    pub fn parameters_are_saved(&mut self) {
        self.is_record_due = self.has_loader;
    }

    /// Writes the next byte of the record of the bus for the bootloader, which needs it also after
    /// a program that hangs: the node ID, and the bit rate of the parameters. Call while no save is
    /// in progress.
    #[inline(never)]
    pub fn step(&mut self, node: u8, parameters: &Parameters, eeprom: &mut impl Eeprom) {
        if !self.is_record_due || eeprom.is_busy() {
            return;
        }
        let timing = bit_rate::timing(parameters.get(Parameter::CanBaudrate) as u8);
        let mut record = [node, timing.cnf3(), timing.cnf2(), timing.cnf1(), 0, 0];
        let mut crc = CRC_START;
        for byte in record.iter().take(4) {
            crc = crc::add(crc, *byte);
        }
        [record[4], record[5]] = crc.to_be_bytes();
        for (at, byte) in (BUS as Address..).zip(record) {
            if eeprom.read(at) != byte {
                eeprom.begin_write(at, byte);
                return;
            }
        }
        self.is_record_due = false;
    }

    /// Decides on a request, and keeps it if it is accepted. `is_in_use`: see
    /// [`are_in_use`](crate::parts::outputs::Outputs::are_in_use).
    pub fn act_on_request(&mut self, request: &Transfer, is_in_use: bool) -> Verdict {
        if !self.has_loader {
            return Verdict::NoLoader;
        }
        if is_in_use {
            return Verdict::InUse;
        }
        let path_len = request.len().wrapping_sub(1);
        if usize::from(path_len) > PATH_LEN {
            return Verdict::PathTooLong;
        }
        let &[server, ref path @ ..] = request.bytes();
        let record = &mut self.request;
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

    /// True if a request was accepted.
    pub fn is_accepted(&self) -> bool {
        self.request[PATH_LEN + 1] != 0
    }

    /// The answer says that the request is accepted. It may come some time after the request,
    /// because it waits for a save.
    pub fn answer(&mut self) {
        self.is_answered = true;
    }

    /// True if a client was told that its request is accepted.
    pub fn is_answered(&self) -> bool {
        self.is_answered
    }

    /// Forgets the accepted request.
    pub fn call_off(&mut self) {
        self.request[PATH_LEN + 1] = 0;
        self.is_answered = false;
    }

    /// Returns the accepted request, if there is one, after the record of the bus is written. Takes
    /// up to 30 ms. The program must end then.
    pub fn hand_over(
        &mut self,
        node: u8,
        parameters: &Parameters,
        eeprom: &mut impl Eeprom,
    ) -> Option<&[u8; REQUEST_LEN]> {
        if !self.is_accepted() {
            return None;
        }
        self.is_record_due = true;
        for _ in 0..=BUS_LEN {
            wait(eeprom);
            self.step(node, parameters, eeprom);
        }
        Some(&self.request)
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
