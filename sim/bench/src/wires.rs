//! Options for the board and its wiring, for programs without the ELF section `.board`, or to run a
//! program on another board.

use crate::avr::Chip;
use crate::corner::{Corner, Setting, Value};
use crate::wiring::{Pin, Wiring, crystal_mhz};
use anyhow::Result;
use clap::Args as ClapArgs;

/// Options for the board. An option replaces the value in the ELF file.
#[derive(Clone, Debug, Default, ClapArgs)]
#[command(next_help_heading = "The board [default: the one that the ELF file names]")]
#[group(id = "wires")]
pub struct Args {
    /// Arduino, by its name in avr-specs/boards.toml: diecimila, uno, nano and so on
    #[arg(long, value_name = "NAME")]
    pub board: Option<String>,

    /// CAN board, by its name in avr-specs/boards.toml: seeed, sparkfun, module and so on
    #[arg(long, value_name = "NAME")]
    pub shield: Option<String>,

    /// Processor, atmega168 or atmega328p
    #[arg(long, value_name = "CHIP")]
    pub mcu: Option<Chip>,

    /// Pin to which the CS of the MCP2515 is wired, such as D10
    #[arg(long, value_name = "PIN")]
    pub cs: Option<Pin>,

    /// Pin to which the INT of the MCP2515 is wired, such as D2
    #[arg(long, value_name = "PIN")]
    pub int: Option<Pin>,

    /// Frequency of the MCP2515's crystal in MHz, as marked on it: 8 or 16
    #[arg(long, value_name = "MHZ", value_parser = crystal_mhz, allow_hyphen_values = true)]
    pub crystal: Option<u32>,

    /// Pin of the servo, whose pulses sim measures: D9 or D10
    #[arg(long, value_name = "PIN")]
    pub servo: Option<Pin>,

    /// Values of a real chip at the edge of its tolerances: typical, slow, fast, worst or
    /// random:SEED
    #[arg(long, env = "NODE_CORNER", value_name = "CORNER", default_value = "typical")]
    pub corner: Corner,

    /// Deviation of the processor's clock, such as +0.4%
    #[arg(
        long,
        value_name = "PERCENT",
        value_parser = |text: &str| Setting::parse(Value::Clock, text),
        allow_hyphen_values = true,
    )]
    pub clock: Option<Setting>,

    /// Time in which a byte of EEPROM is erased and written, in milliseconds, such as 3.8
    #[arg(
        long,
        value_name = "MS",
        value_parser = |text: &str| Setting::parse(Value::Eeprom, text),
        allow_hyphen_values = true,
    )]
    pub eeprom_ms: Option<Setting>,

    /// Any value of the table of --help faults, such as can-start-ms=2000 (repeatable)
    #[arg(long, value_name = "NAME=NUMBER")]
    pub silicon: Vec<Setting>,
}

impl Args {
    /// The values of the chips.
    pub fn corner(&self) -> Corner {
        let mut corner = self.corner;
        let single = self.clock.iter().chain(&self.eeprom_ms).chain(&self.silicon);
        single.for_each(|setting| corner.set(setting));
        corner
    }

    /// Changes a wiring as the options say.
    ///
    /// # Errors
    /// If the table has no such board, or two signals get the same pin.
    pub fn apply(&self, mut wiring: Wiring) -> Result<Wiring> {
        if let Some(board) = &self.board {
            wiring.set_board(board)?;
        }
        if let Some(shield) = &self.shield {
            wiring.set_shield(shield)?;
        }
        wiring.chip = self.mcu.unwrap_or(wiring.chip);
        wiring.crystal_mhz = self.crystal.unwrap_or(wiring.crystal_mhz);
        if let Some(cs) = self.cs {
            wiring.set_cs(cs);
        }
        if let Some(int) = self.int {
            wiring.set_int(int);
        }
        wiring.servo = self.servo.unwrap_or(wiring.servo);
        wiring.check()?;
        Ok(wiring)
    }
}
