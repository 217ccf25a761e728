//! Joins all tables of constants into the one image that lies in flash (see
//! [`progmem`](crate::progmem)).

use crate::hardware::{OutputPins, PACKED_OUTPUT_PINS};
use crate::monitor::text::Texts;
use crate::monitor::{TEXTS, TextsAndNames};
use crate::node::acceptance::{self, Filters};
use crate::progmem::Progmem;
use crate::tables::information::{self, Information};
use crate::tables::kind::{self, DataTypes};
use crate::tables::parameters::{self, Descriptions};

/// A table of the image.
pub trait Table {
    /// Index in [`IMAGE`] of the first byte of the table.
    const BEGIN: u16;
}

impl Table for Information {
    // At the begin, because the bootloader reads it from there, too (see `crate::handover`).
    const BEGIN: u16 = 0;
}

impl Table for Texts {
    const BEGIN: u16 = Information::BEGIN + information::PACKED.len() as u16;
}

impl Table for Descriptions {
    const BEGIN: u16 = Texts::BEGIN + TEXTS.len() as u16;
}

impl Table for Filters {
    const BEGIN: u16 = Descriptions::BEGIN + parameters::PACKED.len() as u16;
}

impl<P: Progmem<Texts> + Progmem<Descriptions>> TextsAndNames for P {
    const NAMES: u16 = Descriptions::BEGIN - Texts::BEGIN + parameters::NAMES;
}

impl Table for OutputPins {
    const BEGIN: u16 = Filters::BEGIN + acceptance::PACKED.len() as u16;
}

impl Table for DataTypes {
    const BEGIN: u16 = OutputPins::BEGIN + PACKED_OUTPUT_PINS.len() as u16;
}

const LEN: usize = DataTypes::BEGIN as usize + kind::PACKED.len();

/// All tables, one after the other.
pub const IMAGE: [u8; LEN] = {
    let mut image = [0; LEN];
    let parts: [&[u8]; 6] = [
        &information::PACKED,
        TEXTS,
        &parameters::PACKED,
        &acceptance::PACKED,
        &PACKED_OUTPUT_PINS,
        &kind::PACKED,
    ];
    let (mut at, mut part) = (0, 0);
    while part < parts.len() {
        let mut n = 0;
        while n < parts[part].len() {
            image[at] = parts[part][n];
            at += 1;
            n += 1;
        }
        part += 1;
    }
    image
};

/// The image in the memory of the host, for tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InMemory;

#[cfg(any(test, feature = "desk"))]
impl<T: Table> Progmem<T> for InMemory {
    fn byte(self, at: u16) -> u8 {
        IMAGE[usize::from(T::BEGIN + at)]
    }
}
