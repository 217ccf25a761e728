//! Keeps the parameters and the unique ID in EEPROM. After a power cut at any moment the EEPROM has
//! either the old or the new parameters (docs/parameters.md).
//!
//! The parameters have two copies, and a cell, the selector, says which one is in force. A save
//! writes the bytes that differ into the other copy, then its CRC, then the selector: it succeeds
//! with this byte. Last it writes the selector again, into the next cell, which counts if the first
//! one means neither copy. Then it is answered, and the store makes the older copy equal, also
//! after a start. So at rest both are equal, a save writes only what has changed since the last
//! one, and a broken byte loses nothing.
//!
//! A byte that is being written during a power cut can get any value. While the first cell of the
//! selector is written, both copies are complete, and the second one still means the older copy. If
//! neither cell means a copy, as in a new chip whose first save was cut, the node takes a copy with
//! a valid CRC, and reports that it may be the wrong one.

#![allow(clippy::useless_conversion, clippy::unnecessary_cast, reason = "Address")]

use dronecan_wire::crc;

use crate::eeprom::{Address, EEPROM_LEN, Eeprom};
use crate::handover::{
    BUS, BUS_LEN, UNIQUE_ID, UNIQUE_ID_CRC_START, UNIQUE_ID_LEN, UNIQUE_ID_RECORD_LEN,
};
use crate::hardware::OUTPUTS;
use crate::progmem::Progmem;
use crate::tables::parameters::{self, CELLS, Descriptions, IS_PACKED, Parameters};

/// Address of the selector.
const SELECTOR: Address = 0x1E;

/// Cells of the selector.
const SELECTOR_LEN: u8 = 2;

/// The selector while the first copy is in force, and the second. They differ in all bits, so that
/// a broken bit turns neither into the other one. An erased cell is neither.
const FIRST: u8 = 0x3C;
const SECOND: u8 = !FIRST;

/// The bit of the address that differs between a byte of the first copy and the same byte of the
/// second.
const OTHER: Address = if OUTPUTS == 1 { 0x80 } else { 0x200u16 as Address };

/// Addresses of the two copies of the parameters.
const PARAMETERS: [Address; 2] = [0x20, 0x20 | OTHER];

const CRC_LEN: u8 = 2;

/// Bytes of a copy of the parameters.
const LEN: usize = CELLS + CRC_LEN as usize;

const _: () = assert!(SELECTOR >= (BUS + BUS_LEN) as Address);
const _: () = assert!(SELECTOR + SELECTOR_LEN as Address == PARAMETERS[0]);
// `Store::at` counts on while the selector is written.
const _: () = assert!(
    PARAMETERS[0] as usize + LEN + (SELECTOR_LEN as usize) < OTHER as usize
        && PARAMETERS[1] as usize + LEN + (SELECTOR_LEN as usize) < EEPROM_LEN,
    "the EEPROM has no room for this many parameters"
);

/// Address of the last byte of the unique ID's record, which the loader requires to be 0.
const MARKER: u8 = UNIQUE_ID + UNIQUE_ID_RECORD_LEN - 1;

/// The value of an erased byte.
const ERASED: u8 = 0xFF;

/// The initial CRC of the parameters: the digest of names and ranges, so that a copy of a build
/// with another table is invalid.
const CRC_OF_PARAMETERS: u16 = parameters::DIGEST;

// A record of zeros is invalid.
const _: () = assert!(CRC_OF_PARAMETERS != 0);

/// Samples of noise in a unique ID. Even a sample near the typical 16 ms has a random bit or more
/// (see `board::jitter`). With 64 samples, the probability that two in a million boards have the
/// same ID is 3e-8.
const SAMPLES: u8 = 64;

/// Steps at each tick. With several outputs each turn of the main loop that has nothing else to do
/// does a step, too.
const STEPS: u8 = if OUTPUTS == 1 { 1 } else { 2 };

/// The EEPROM has the parameters that were saved, in both copies.
const DONE: u8 = 0;
/// The byte that was written last is not checked yet.
const TRYING: u8 = 1 << 0;
/// The selector is to be written: the copies differ.
const COMMITS: u8 = 1 << 1;
/// The older copy is being made equal to the copy in force.
const COPIES: u8 = 1 << 2;
/// With `COPIES`: the parameters have changed, so the bytes come from the copy in force. Otherwise
/// they come from the RAM, because a byte of this copy may break meanwhile.
const CHANGED: u8 = 1 << 3;
/// A save is in progress.
const SAVES: u8 = 1 << 4;
/// The EEPROM did not keep a byte, or has no copy that is certainly the newest.
const FAILED: u8 = 1 << 5;

/// The state of the EEPROM, and of the copy that is being written.
pub struct Store {
    state: u8,
    /// Address of the next byte to write.
    at: Address,
    /// Place of this byte in the values, or behind them in the CRC.
    place: Address,
    /// CRC of the bytes before it.
    crc: u16,
}

impl Store {
    /// A store before [`identify`](Self::identify) and [`load`](Self::load).
    pub const fn new() -> Self {
        Self { state: DONE, at: 0, place: 0, crc: 0 }
    }

    /// Gives the unique ID from EEPROM. If there is none, makes one from 64 samples of `noise` and
    /// stores it. That takes a second, so call it before the main loop only.
    pub fn identify(
        &mut self,
        id: &mut [u8; UNIQUE_ID_LEN as usize],
        eeprom: &mut impl Eeprom,
        flash: impl Progmem<Descriptions>,
        mut noise: impl FnMut() -> u8,
    ) {
        if read(id, UNIQUE_ID.into(), UNIQUE_ID_CRC_START, eeprom, flash) {
            return;
        }
        for sample in 0..SAMPLES {
            let byte = &mut id[usize::from(sample % UNIQUE_ID_LEN)];
            // The lowest bits of a sample have the noise.
            *byte = byte.rotate_left(2) ^ noise();
        }
        // An ID of zeros would be invalid.
        id[0] |= 1;
        eeprom.begin_write(MARKER.into(), 0);
        self.at = UNIQUE_ID.into();
        self.crc = UNIQUE_ID_CRC_START;
        // Writes 19 bytes of 3.4 ms each; a turn takes 25 cycles or more. The limit ends the loop
        // if the EEPROM stays busy.
        let mut turns = u16::MAX;
        while turns != 0 && self.place != (UNIQUE_ID_LEN + CRC_LEN) as Address {
            turns -= 1;
            self.write(id, eeprom, flash);
        }
        self.state = DONE;
    }

    /// Loads the parameters, or sets the defaults. Returns true if something was lost: the copy in
    /// force, both copies, the selector, or values that are out of their ranges. Call before the
    /// main loop, and before any save.
    pub fn load(
        &mut self,
        parameters: &mut Parameters,
        eeprom: &impl Eeprom,
        flash: impl Progmem<Descriptions>,
    ) -> bool {
        let mut selector = eeprom.read(SELECTOR);
        if !is_selector(selector) {
            selector = eeprom.read(SELECTOR + 1);
        }
        let mut is_lost = false;
        self.at = PARAMETERS[0];
        if selector != FIRST {
            self.at = PARAMETERS[1];
            is_lost = selector != SECOND;
        }
        for _ in 0..PARAMETERS.len() {
            let at = self.at;
            self.at ^= OTHER;
            if read(parameters.bytes(), at, CRC_OF_PARAMETERS, eeprom, flash) {
                is_lost |= parameters.repair(flash);
                // What was lost stays as it is until a save replaces it.
                self.begin(if is_lost { FAILED } else { COPIES });
                return is_lost;
            }
            is_lost = true;
        }
        parameters.set_defaults(flash);
        // The first save writes the copy that the selector does not mean, in a new chip the first.
        self.at ^= OTHER;
        has_parameters(eeprom)
    }

    /// Begins to save the parameters in force, unless a save is in progress. If the EEPROM has
    /// them, no byte is written.
    pub fn save(&mut self) {
        if !self.is_saving() {
            // Only after a copy is complete the selector may stay.
            self.begin(if self.state == DONE { SAVES } else { SAVES | COMMITS });
        }
    }

    /// Begins the save in progress again, if there is one: a parameter has changed.
    pub fn save_again(&mut self) {
        if self.is_saving() {
            self.begin(SAVES | COMMITS);
        } else if self.state & COPIES != 0 {
            self.state |= CHANGED;
        }
    }

    /// True while a save is in progress.
    pub fn is_saving(&self) -> bool {
        self.state & SAVES != 0
    }

    /// True if the last save succeeded: every byte was read back.
    pub fn is_saved(&self) -> bool {
        self.state & (SAVES | FAILED) == 0
    }

    /// Does the next steps of a save in progress, or of the copy after it. Call at each tick.
    pub fn step(
        &mut self,
        parameters: &mut Parameters,
        eeprom: &mut impl Eeprom,
        flash: impl Progmem<Descriptions>,
    ) {
        for _ in 0..STEPS {
            self.step_once(parameters, eeprom, flash);
        }
    }

    /// Does the next step. Takes 10 us, or much less while a byte is being written.
    #[inline(always)]
    pub fn step_once(
        &mut self,
        parameters: &mut Parameters,
        eeprom: &mut impl Eeprom,
        flash: impl Progmem<Descriptions>,
    ) {
        if self.state & (SAVES | COPIES) != 0 {
            self.write(parameters.bytes(), eeprom, flash);
        }
    }

    /// Begins to write the copy that is not in force.
    #[inline(never)]
    fn begin(&mut self, state: u8) {
        self.state = state;
        self.at = self.at & OTHER | PARAMETERS[0];
        self.place = 0;
        self.crc = CRC_OF_PARAMETERS;
    }

    /// Writes the next byte, or checks the byte that was written.
    #[inline(never)]
    fn write(&mut self, bytes: &[u8], eeprom: &mut impl Eeprom, flash: impl Progmem<Descriptions>) {
        if eeprom.is_busy() {
            return;
        }
        let end = (bytes.len() as Address).wrapping_add(CRC_LEN.into());
        let mut at = self.at;
        let byte = if self.place >= end {
            at = SELECTOR.wrapping_add(self.place.wrapping_sub(end));
            if self.at & OTHER == 0 { FIRST } else { SECOND }
        } else if self.state & CHANGED != 0 {
            eeprom.read(at ^ OTHER)
        } else {
            match bytes.get(usize::from(self.place)) {
                Some(&byte) => byte,
                // After the bytes comes the high byte of the CRC. Adding that byte to the CRC moves
                // the low byte into its place.
                None => (self.crc >> 8) as u8,
            }
        };
        if eeprom.read(at) != byte {
            if self.state & TRYING != 0 {
                self.state = FAILED;
                return;
            }
            self.state |= TRYING | COMMITS;
            eeprom.begin_write(at, byte);
            return;
        }
        self.state &= !TRYING;
        self.crc = crc::add(self.crc, byte);
        self.at = self.at.wrapping_add(1);
        self.place = self.place.wrapping_add(1);
        if usize::from(self.place) < bytes.len() && is_left_out(self.place, self.at, flash) {
            self.place = self.place.wrapping_add(1);
        }
        if self.place == end && self.state & (COPIES | COMMITS) != COMMITS {
            self.state = DONE;
        }
        if self.place == end.wrapping_add(SELECTOR_LEN.into()) {
            self.at ^= OTHER;
            self.begin(COPIES);
        }
    }
}

/// True if the selector means a copy.
fn is_selector(cell: u8) -> bool {
    cell == FIRST || cell == SECOND
}

/// True if the EEPROM has no byte for the upper byte of a value, at this place in the values.
#[inline(never)]
fn is_left_out(place: Address, at: Address, flash: impl Progmem<Descriptions>) -> bool {
    IS_PACKED
        && place & 1 != 0
        && at >= PARAMETERS[0]
        && parameters::is_byte((place >> 1) as u8, flash)
}

/// True if a save has begun. The first one writes the first copy.
pub fn has_parameters(eeprom: &impl Eeprom) -> bool {
    eeprom.read(PARAMETERS[0]) != ERASED
}

/// Reads the record at an address. Returns true if it is valid.
#[inline(never)]
fn read(
    bytes: &mut [u8],
    mut at: Address,
    mut crc: u16,
    eeprom: &impl Eeprom,
    flash: impl Progmem<Descriptions>,
) -> bool {
    let mut place = 0;
    for byte in bytes {
        *byte = 0;
        if !is_left_out(place, at, flash) {
            *byte = eeprom.read(at);
            crc = crc::add(crc, *byte);
            at = at.wrapping_add(1);
        }
        place = place.wrapping_add(1);
    }
    let [low, high] = crc.to_le_bytes();
    eeprom.read(at) == high && eeprom.read(at.wrapping_add(1)) == low
}

#[cfg(test)]
mod tests;
