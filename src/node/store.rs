//! Keeps the parameters and the unique ID in EEPROM. After a power cut at any moment the EEPROM has
//! either the old or the new parameters (docs/parameters.md).
//!
//! A record is its bytes, their CRC (high byte first), and a marker. To overwrite a record, the
//! store first erases its marker, which makes the record invalid. Then it writes the bytes and the
//! CRC, and last the new marker. A byte that is being written during a power cut can get any value,
//! so the CRC also covers the marker.
//!
//! The parameters have two records, and a save overwrites the older one. The marker has a count of
//! the saves, modulo 4, which distinguishes the newer record from the older, and the version of the
//! layout.

#![allow(clippy::useless_conversion, clippy::unnecessary_cast, reason = "Address")]

use dronecan_wire::crc;

use crate::eeprom::{Address, EEPROM_LEN, Eeprom};
use crate::hardware::OUTPUTS;
use crate::progmem::Progmem;
use crate::tables::parameters::{self, Descriptions, Parameters, VALUES_LEN};

/// Bytes of a unique ID (DSDL uavcan/protocol/HardwareVersion.uavcan).
pub const UNIQUE_ID_LEN: u8 = 16;

/// Address of the unique ID. The first addresses are unused: a failing supply most likely corrupts
/// them.
const UNIQUE_ID: Address = 0x04;

/// Addresses of the two records of the parameters.
const PARAMETERS: [Address; 2] = [0x020, if OUTPUTS == 1 { 0x90 } else { 0x120u16 as Address }];

/// XOR with this turns one of the two addresses into the other.
const OTHER: Address = PARAMETERS[0] ^ PARAMETERS[1];

const CRC_LEN: u8 = 2;

/// Offset of the marker in a record of the parameters.
const MARKER: u8 = VALUES_LEN + CRC_LEN;

const _: () = assert!(PARAMETERS[0] > UNIQUE_ID + (UNIQUE_ID_LEN + CRC_LEN) as Address);
const _: () = assert!(
    PARAMETERS[0] + (MARKER as Address) < PARAMETERS[1]
        && PARAMETERS[1] as usize + (MARKER as usize) < EEPROM_LEN
);

/// The value of an erased byte.
const ERASED: u8 = 0xFF;

/// The marker of an invalid record.
const NO_RECORD: u8 = ERASED;

/// In the marker of parameters: the lower two bits count the saves.
const COUNT_MASK: u8 = 3;

/// In the marker of parameters: the upper six bits are the version of the layout, 1 to 62. Records
/// of another version are invalid. The unique ID has a marker of 0 and stays valid.
const LAYOUT: u8 = 4 << 2;

/// The marker of the next save.
fn next(marker: u8) -> u8 {
    marker.wrapping_add(1) & COUNT_MASK | LAYOUT
}

/// True if a marker belongs to parameters in this layout.
fn is_usable(marker: u8) -> bool {
    marker & !COUNT_MASK == LAYOUT
}

/// In place of the marker to write now: the parameters are compared with those in the EEPROM, and
/// no byte is written unless one differs. No record has it.
const COMPARED: u8 = 1;

/// The marker of the unique ID.
const UNIQUE_ID_MARKER: u8 = 0;

/// The initial CRC of a record. It includes the marker, and it makes a record of zeros invalid. For
/// parameters it is based on the digest of names and ranges, so that a record of a build with
/// another table is invalid.
fn crc_start(marker: u8) -> u16 {
    let start = if marker == UNIQUE_ID_MARKER { 0x0100 } else { parameters::DIGEST };
    start ^ u16::from(marker)
}

/// Samples of noise in a unique ID. Even a sample near the typical 16 ms has a random bit or more
/// (see `board::jitter`). With 64 samples, the probability that two in a million boards have the
/// same ID is 3e-8.
const SAMPLES: u8 = 64;

/// Steps of a save at each call: the check of a byte, and with many parameters the write of the
/// next one, too. Clients wait for a second; `tests/boards/parameters.rs` limits a save to 0.95 s.
const STEPS: u8 = if OUTPUTS == 1 { 1 } else { 2 };

/// The same while the store compares, before the first write. 16 steps take 130 us.
const STEPS_OF_COMPARISON: u8 = if OUTPUTS == 1 { 1 } else { 16 };

/// The state of a save.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
enum Saving {
    /// The EEPROM has the parameters that were in force.
    Done,
    /// The EEPROM did not keep a byte, or the newer record was lost.
    Failed,
    /// The save is in progress.
    Going,
    /// The save is in progress, and the byte that was written last is not checked yet.
    Trying,
}

/// The state of the EEPROM, and of the record that is being written.
pub struct Store {
    saving: Saving,
    /// Address of the record that is being written, or is next.
    base: Address,
    /// The record's new marker, and the marker to write now.
    next_marker: u8,
    marker: u8,
    /// Offset of the next byte in the record, and the CRC of the bytes before it.
    place: u8,
    crc: u16,
}

impl Store {
    /// A store before [`identify`](Self::identify) and [`load`](Self::load).
    pub const fn new() -> Self {
        Self { saving: Saving::Done, base: 0, next_marker: 0, marker: 0, place: 0, crc: 0 }
    }

    /// Gives the unique ID from EEPROM. If there is none, makes one from 64 samples of `noise` and
    /// stores it. That takes a second, so call it before the main loop only.
    pub fn identify(
        &mut self,
        id: &mut [u8; UNIQUE_ID_LEN as usize],
        eeprom: &mut impl Eeprom,
        mut noise: impl FnMut() -> u8,
    ) {
        if read(id, UNIQUE_ID, eeprom) != NO_RECORD {
            return;
        }
        for sample in 0..SAMPLES {
            let byte = &mut id[usize::from(sample % UNIQUE_ID_LEN)];
            // The lowest bits of a sample have the noise.
            *byte = byte.rotate_left(2) ^ noise();
        }
        // An ID of zeros would be invalid.
        id[0] |= 1;
        self.base = UNIQUE_ID;
        self.begin(UNIQUE_ID_LEN + CRC_LEN, NO_RECORD);
        // Writes 20 bytes of 3.4 ms each; a turn takes 25 cycles or more. The limit ends the loop
        // if the EEPROM stays busy.
        let mut turns = u16::MAX;
        while turns != 0 && self.is_saving() {
            turns -= 1;
            self.write(id, eeprom);
        }
    }

    /// Loads the newest good copy of the parameters, or sets the defaults. Returns true if
    /// something was lost: the newest copy, both copies, or values that are out of their
    /// ranges. Call before the main loop, and before any save.
    pub fn load(
        &mut self,
        parameters: &mut Parameters,
        eeprom: &impl Eeprom,
        flash: impl Progmem<Descriptions>,
    ) -> bool {
        let first = eeprom.read(PARAMETERS[0].wrapping_add(MARKER.into()));
        let second = eeprom.read(PARAMETERS[1].wrapping_add(MARKER.into()));
        let (mut base, mut newest) = (PARAMETERS[0], first);
        if second.wrapping_sub(first) & COUNT_MASK == 1 {
            (base, newest) = (PARAMETERS[1], second);
        }
        let mut marker = read(parameters.bytes(), base, eeprom);
        let mut is_lost = false;
        if !is_usable(marker) {
            // A save that was cut leaves no marker, or any byte in its place, seldom one of this
            // layout. So a copy with such a marker was complete, and has changed.
            is_lost = is_usable(newest);
            base ^= OTHER;
            marker = read(parameters.bytes(), base, eeprom);
        }
        if is_usable(marker) {
            self.base = base ^ OTHER;
            self.next_marker = next(marker);
            if is_lost {
                self.saving = Saving::Failed;
            }
            return parameters.repair(flash) || is_lost;
        }
        parameters.set_defaults(flash);
        // The first save writes the first copy, beginning with CAN_NODE, and makes it newer than
        // the second, whatever that is.
        self.base = PARAMETERS[0];
        self.next_marker = next(second);
        has_parameters(eeprom)
    }

    /// Begins to save the parameters in force, unless a save is in progress. If the EEPROM has
    /// them, no byte is written.
    pub fn save(&mut self) {
        if self.saving == Saving::Done {
            self.begin(0, COMPARED);
        } else if self.saving == Saving::Failed {
            self.begin(MARKER, NO_RECORD);
        }
    }

    /// Begins the save in progress again, if there is one: a parameter has changed.
    pub fn save_again(&mut self) {
        if self.is_saving() {
            self.begin(MARKER, NO_RECORD);
        }
    }

    /// True while a save is in progress.
    pub fn is_saving(&self) -> bool {
        self.saving >= Saving::Going
    }

    /// True if the last save succeeded: every byte was read back.
    pub fn is_saved(&self) -> bool {
        self.saving == Saving::Done
    }

    /// Does the next step of a save in progress. Call in the main loop: takes 10 us, or much less
    /// while a byte is being written.
    pub fn step(&mut self, parameters: &mut Parameters, eeprom: &mut impl Eeprom) {
        let steps = if self.marker == COMPARED { STEPS_OF_COMPARISON } else { STEPS };
        for _ in 0..steps {
            if self.is_saving() {
                self.write(parameters.bytes(), eeprom);
            }
        }
    }

    /// Begins to write the current record: erases its marker, which is at offset `end`.
    #[inline(never)]
    fn begin(&mut self, place: u8, marker: u8) {
        self.place = place;
        self.marker = marker;
        self.saving = Saving::Going;
    }

    /// Writes the next byte of the current record, or checks the byte that was written.
    #[inline(never)]
    fn write(&mut self, bytes: &[u8], eeprom: &mut impl Eeprom) {
        if eeprom.is_busy() {
            return;
        }
        let end = (bytes.len() as u8).wrapping_add(CRC_LEN);
        let mut byte = self.marker;
        let is_comparing = self.marker == COMPARED;
        if self.place != end {
            byte = match bytes.get(usize::from(self.place)) {
                Some(&byte) => byte,
                None if is_comparing => {
                    self.saving = Saving::Done;
                    return;
                }
                // After the bytes comes the high byte of the CRC. Adding that byte to the CRC moves
                // the low byte into its place.
                None => (self.crc >> 8) as u8,
            };
        }
        let base = if is_comparing { self.base ^ OTHER } else { self.base };
        let at = base.wrapping_add(self.place.into());
        if eeprom.read(at) != byte {
            if is_comparing {
                return self.begin(MARKER, NO_RECORD);
            }
            if self.saving == Saving::Trying {
                self.saving = Saving::Failed;
                return;
            }
            self.saving = Saving::Trying;
            eeprom.begin_write(at, byte);
            return;
        }
        self.saving = Saving::Going;
        self.crc = crc::add(self.crc, byte);
        self.place = self.place.wrapping_add(1);
        if self.place <= end {
            return;
        }
        if self.marker == NO_RECORD {
            self.place = 0;
            self.marker = self.next_marker;
            self.crc = crc_start(self.marker);
        } else {
            self.saving = Saving::Done;
            self.base ^= OTHER;
            self.next_marker = next(self.next_marker);
        }
    }
}

/// True if something was saved. The markers are no test, because tables of other lengths have them
/// elsewhere.
pub fn has_parameters(eeprom: &impl Eeprom) -> bool {
    eeprom.read(PARAMETERS[0]) != ERASED
}

/// Reads the record at an address. Returns its marker; [`NO_RECORD`] if it is invalid.
#[inline(never)]
fn read(bytes: &mut [u8], base: Address, eeprom: &impl Eeprom) -> u8 {
    let marker =
        eeprom.read(base.wrapping_add(bytes.len() as Address).wrapping_add(CRC_LEN.into()));
    let mut crc = crc_start(marker);
    let mut at = base;
    for place in bytes {
        *place = eeprom.read(at);
        crc = crc::add(crc, *place);
        at = at.wrapping_add(1);
    }
    let [low, high] = crc.to_le_bytes();
    if eeprom.read(at) != high || eeprom.read(at.wrapping_add(1)) != low {
        return NO_RECORD;
    }
    marker
}

impl Default for Store {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
