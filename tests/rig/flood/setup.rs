//! The programs that ship, each with its outputs, and their EEPROMs.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use bench::avr::Chip;
use bench::firmware_for;
use bench::wiring::Wiring;

use super::super::Rig;

/// A program that ships.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Preset {
    Default,
    Remote,
    Thesis,
    Full,
}

/// The pulses of motors: ESC_PWM_TYPE and ESC_RATE.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Escs {
    /// The defaults: normal pulses at 50 Hz.
    Slow,
    /// Normal pulses at 400 Hz.
    Fast,
    /// OneShot125 at 400 Hz.
    OneShot125,
}

/// A program and its outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Setup {
    pub preset: Preset,
    /// Number of outputs that are servos: the first ones, with the IDs 1, 2 and so on.
    pub servos: usize,
    /// Number of outputs that are motors: those after the servos, with the indices 0, 1 and so on.
    pub motors: usize,
    pub escs: Escs,
}

impl Setup {
    /// The setups whose frames are counted.
    pub const ALL: [Setup; 8] = [
        Setup::of(Preset::Default, 1, 0),
        Setup::of(Preset::Remote, 1, 0),
        Setup::of(Preset::Thesis, 1, 0),
        Setup::of(Preset::Full, 1, 0),
        Setup::of(Preset::Full, 4, 0),
        Setup::of(Preset::Full, 8, 0),
        Setup::of(Preset::Full, 0, 8),
        Setup::of(Preset::Full, 4, 4),
    ];

    /// A program with so many servos and motors.
    pub const fn of(preset: Preset, servos: usize, motors: usize) -> Setup {
        Setup { preset, servos, motors, escs: Escs::Slow }
    }

    /// The preset `full` with so many motors that have these pulses.
    pub const fn of_escs(motors: usize, escs: Escs) -> Setup {
        Setup { escs, ..Setup::of(Preset::Full, 0, motors) }
    }

    /// Number of outputs in use.
    pub fn outputs(&self) -> usize {
        self.servos + self.motors
    }

    /// The board that the program is for, with a Seeed shield.
    pub fn board(&self) -> &'static str {
        if self.preset == Preset::Full { "uno" } else { "diecimila" }
    }

    /// The chip that the program is for.
    #[track_caller]
    pub fn chip(&self) -> Chip {
        Wiring::of(self.board(), "seeed").unwrap_or_else(|error| panic!("{error:#}")).chip
    }

    /// True if the program speaks DroneCAN v0, and the draft of 2014 otherwise.
    pub fn is_v0(&self) -> bool {
        self.preset != Preset::Thesis
    }

    /// The program's ELF. Panics with what to do if it is missing.
    #[track_caller]
    pub fn elf(&self) -> PathBuf {
        let name = format!("{:?}", self.preset).to_lowercase();
        firmware_for(self.board(), "seeed", &name).unwrap_or_else(|error| panic!("{error:#}"))
    }

    /// A board that runs this program with these outputs, and publishes as often as it can. Its
    /// servos have no failsafe.
    #[track_caller]
    pub fn running(&self) -> Rig {
        Rig::running_elf(&self.elf(), &self.eeprom())
    }

    fn eeprom(&self) -> Vec<u8> {
        static EEPROMS: Mutex<BTreeMap<Setup, Vec<u8>>> = Mutex::new(BTreeMap::new());
        // A thread that panicked here has not changed the map.
        let mut eeproms = EEPROMS.lock().unwrap_or_else(PoisonError::into_inner);
        eeproms.entry(*self).or_insert_with(|| self.configured()).clone()
    }

    /// EEPROM of a board with these outputs.
    fn configured(&self) -> Vec<u8> {
        let mut rig = Rig::with_firmware(&self.elf());
        rig.wait_until_up();
        if self.is_v0() {
            rig.set("TELEM_RATE", 50);
            rig.set("TEMP_RATE", 50);
            if self.outputs() > 1 {
                rig.set("OUT_COUNT", self.outputs() as i64);
            }
            for output in 1..=self.outputs() {
                rig.set(&format!("OUT{output}_TIMEOUT"), 0);
            }
            for motor in 0..self.motors {
                let output = self.servos + motor + 1;
                rig.set(&format!("OUT{output}_TYPE"), 1);
                rig.set(&format!("OUT{output}_ID"), motor as i64);
            }
            if self.escs == Escs::OneShot125 {
                rig.set("ESC_PWM_TYPE", 3);
            }
            if self.escs != Escs::Slow {
                rig.set("ESC_RATE", 400);
            }
            rig.save();
        }
        rig.board().avr().eeprom()
    }
}

impl fmt::Display for Setup {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", format!("{:?}", self.preset).to_lowercase())?;
        match (self.preset, self.servos, self.motors) {
            (Preset::Full, servos, 0) => write!(f, ", servos {servos}")?,
            (Preset::Full, 0, motors) => write!(f, ", motors {motors}")?,
            (Preset::Full, servos, motors) => write!(f, ", servos {servos}, motors {motors}")?,
            _ => (),
        }
        match self.escs {
            Escs::Slow => Ok(()),
            fast => write!(f, ", {fast:?}"),
        }
    }
}
