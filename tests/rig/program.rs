//! Which firmware a test runs, and the rigs that run it.

use std::path::PathBuf;

use bench::wiring::preset;
use bench::{firmware, firmware_for, node_elf};

use super::{Rig, board, started_with};

/// A firmware under test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Program {
    /// The preset of the board's chip, or the ELF that `NODE_ELF` names.
    Preset,
    /// With all features of the preset `full`, for which the ATmega168 has no room: the preset of
    /// the board's chip if it is `full`, otherwise that of the Uno.
    Full,
    /// The preset `thesis` of the board.
    Thesis,
    /// With a feature that no preset has, on an Uno.
    With(&'static str),
}

/// True if the preset of the board's chip has all features.
pub fn has_all_features() -> bool {
    preset(board().chip) == "full"
}

impl Program {
    /// The ELF. Panics if it has not been built.
    pub fn elf(self) -> PathBuf {
        let elf = match self {
            Program::Full if !has_all_features() => firmware_for("uno", "seeed", "full"),
            Program::Preset | Program::Full => node_elf(),
            Program::Thesis => firmware("thesis"),
            Program::With(feature) => firmware_for("uno", "seeed", feature),
        };
        elf.unwrap_or_else(|error| panic!("{error:#}"))
    }

    /// EEPROM of a board that has started before, and so has a unique ID.
    pub fn started(self) -> &'static [u8] {
        started_with(&self.elf())
    }

    /// Boards with these EEPROMs, powered up now. Each has its own seed, so that clocks and noise
    /// differ.
    pub fn with_boards(self, eeproms: &[&[u8]]) -> Rig {
        Rig::with_boards_of(&self.elf(), eeproms)
    }

    /// A board that has started before and is powered up now, with the peer on a bus of the highest
    /// bit rate that the board supports.
    pub fn powered(self) -> Rig {
        self.with_boards(&[self.started()])
    }

    /// A board that is powered up for the first time.
    pub fn new_board(self) -> Rig {
        self.with_boards(&[&[]])
    }

    /// A running board: it has sent its first status, and the record of that is cleared.
    #[track_caller]
    pub fn running(self) -> Rig {
        self.running_with(self.started())
    }

    /// Like [`Program::running`] with this EEPROM.
    #[track_caller]
    pub fn running_with(self, eeprom: &[u8]) -> Rig {
        Rig::running_elf(&self.elf(), eeprom)
    }

    /// A running board that has started with these parameters.
    #[track_caller]
    pub fn running_set(self, values: &[(&str, i64)]) -> Rig {
        let mut rig = self.running();
        rig.set_all(values);
        rig.save();
        rig.restart();
        rig
    }

    /// A running board that has followed a first command, from node 10: its servo is at 1750 us.
    #[track_caller]
    pub fn positioned(self) -> Rig {
        let mut rig = self.running();
        rig.send_command(1, 0, 0.5);
        assert_eq!(rig.settled_pulse_us(), 1750.0);
        rig
    }
}
