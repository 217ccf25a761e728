//! Boards with programs.

use std::path::Path;

use anyhow::{Context, Result};

use super::Board;
use crate::avr::{Avr, Firmware};
use crate::firmware::{corner, processor};
use crate::wiring::Wiring;

impl Board {
    /// A board with the firmware of an ELF file, powered on at time 0.
    ///
    /// # Errors
    /// If the file is missing, or is not a program for a board that the simulator knows.
    pub fn load(elf: &Path) -> Result<Board> {
        let firmware = Firmware::read(elf)?;
        let wiring = Wiring::of_program(&firmware).with_context(|| elf.display().to_string())?;
        Board::programmed(&wiring, &firmware).with_context(|| elf.display().to_string())
    }

    /// A board with the firmware of an ELF file and the given wiring, powered on at time 0.
    ///
    /// # Errors
    /// Those of [`Board::load`], and if the wiring is impossible.
    pub fn load_as(elf: &Path, wiring: &Wiring) -> Result<Board> {
        Board::programmed(wiring, &Firmware::read(elf)?).with_context(|| elf.display().to_string())
    }

    /// A board with a firmware that is read already, powered on at time 0.
    ///
    /// # Errors
    /// If the firmware does not fit the chip, the wiring is impossible, or [`processor`] or
    /// [`corner`] fails.
    pub fn programmed(wiring: &Wiring, firmware: &Firmware) -> Result<Board> {
        Board::in_corner(Avr::programmed_on(processor()?, wiring.chip, firmware)?, wiring)
    }

    /// [`Board::wired`], with the values of [`corner`], but for those of the ADC, and with pulses
    /// counted in cycles of the chip.
    ///
    /// # Errors
    /// If the wiring is impossible, or [`corner`] fails.
    pub fn in_corner(avr: Avr, wiring: &Wiring) -> Result<Board> {
        let mut board = Board::wired(avr, wiring)?;
        if let Some(corner) = corner()? {
            board.set_corner(&corner.with_typical_adc());
            board.count_own_cycles();
        }
        Ok(board)
    }

    /// A board with the given AVR. The wiring is that of the AVR's program, or else the default.
    ///
    /// # Panics
    /// If the wiring is impossible.
    pub fn new(avr: Avr) -> Board {
        let wiring = Wiring::of_section(avr.board_section());
        wiring
            .and_then(|wiring| Board::in_corner(avr, &wiring))
            .unwrap_or_else(|error| panic!("{error:#}"))
    }
}
