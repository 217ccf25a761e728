//! Keeps the EEPROM of a board in a file from run to run.
//!
//! The file is the image of the EEPROM, byte for byte. The link writes it every two seconds if the
//! image has changed, and at the end of the run. It writes a new file and renames it, so the file
//! is always complete. A run that is killed loses the changes of its last two seconds.

use super::Link;
use crate::usage::OrUsage;
use anyhow::{Context, Result, ensure};
use bench::Bench;
use bench::avr::Chip;
use bench::{Cycles, F_CPU_HZ};
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// Simulated time between two checks for changes.
const SAVE_PERIOD: Cycles = 2 * F_CPU_HZ;

/// The file with the EEPROM of one board.
pub struct EepromFile {
    path: PathBuf,
    board: usize,
    saved: Vec<u8>,
    next_at: Cycles,
}

impl EepromFile {
    /// Loads the file, if it exists, into the EEPROM of the board with number `board`.
    ///
    /// # Errors
    /// If the file cannot be read or has another size than the EEPROM.
    pub fn open(path: &Path, bench: &mut Bench, board: usize) -> Result<EepromFile> {
        let avr = bench.board(board).avr_mut();
        // Checks the size before reading: a wrong file can be very long.
        match fs::metadata(path) {
            Ok(file) => {
                check_image(&file, avr.chip())
                    .with_context(|| path.display().to_string())
                    .or_usage()?;
                let cells =
                    fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
                avr.set_eeprom(&cells);
            }
            Err(error) if error.kind() == ErrorKind::NotFound => {
                let parent = path
                    .parent()
                    .filter(|parent| !parent.as_os_str().is_empty())
                    .unwrap_or(Path::new("."));
                ensure!(
                    parent.is_dir(),
                    "there is no directory {} for an EEPROM",
                    parent.display()
                );
            }
            Err(error) => {
                return Err(error).with_context(|| format!("cannot read {}", path.display()));
            }
        }
        Ok(EepromFile { path: path.to_owned(), board, saved: avr.eeprom(), next_at: 0 })
    }

    fn save(&mut self, bench: &mut Bench) -> Result<()> {
        let cells = bench.board(self.board).avr().eeprom();
        if cells == self.saved {
            return Ok(());
        }
        let mut name = OsString::from(&self.path);
        name.push(".new");
        File::create(&name)
            .and_then(|mut file| file.write_all(&cells).and_then(|()| file.sync_data()))
            .and_then(|()| fs::rename(&name, &self.path))
            .with_context(|| format!("cannot write {}", self.path.display()))?;
        self.saved = cells;
        Ok(())
    }
}

/// Rejects a file that is not an image of the chip's EEPROM.
fn check_image(file: &fs::Metadata, chip: Chip) -> Result<()> {
    ensure!(file.is_file(), "is not a regular file, so it cannot hold an EEPROM");
    ensure!(
        file.len() == chip.eeprom_bytes() as u64,
        "has {} bytes, but the EEPROM of an {chip} has {}: is it another file?",
        file.len(),
        chip.eeprom_bytes()
    );
    Ok(())
}

impl Link for EepromFile {
    fn serve(&mut self, bench: &mut Bench) -> Result<()> {
        if bench.now() < self.next_at {
            return Ok(());
        }
        self.next_at = bench.now() + SAVE_PERIOD;
        self.save(bench)
    }

    fn finish(&mut self, bench: &mut Bench) -> Result<()> {
        self.save(bench)
    }

    fn status(&self) -> String {
        format!("EEPROM in {}", self.path.display())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::links::scratch::Scratch;
    use bench::avr::{Avr, Chip};
    use bench::board::Board;

    fn bench() -> Bench {
        let mut bench = Bench::new(1_000_000);
        bench.add_board(Board::new(Avr::blank(Chip::Atmega168).unwrap()), "node");
        bench
    }

    #[test]
    fn the_next_run_finds_the_eeprom_of_the_last() {
        let scratch = Scratch::new();
        let path = scratch.path("eeprom");
        let mut first = bench();
        let mut file = EepromFile::open(&path, &mut first, 0).unwrap();
        file.serve(&mut first).unwrap();
        assert!(!path.exists(), "nothing was written, so there is nothing to keep");
        first.board(0).avr_mut().set_eeprom(&[1, 2, 3]);
        file.finish(&mut first).unwrap();
        let mut second = bench();
        EepromFile::open(&path, &mut second, 0).unwrap();
        assert_eq!(second.board(0).avr().eeprom()[..4], [1, 2, 3, 0xFF]);
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn changes_are_saved_during_the_run() {
        let scratch = Scratch::new();
        let path = scratch.path("eeprom");
        let mut bench = bench();
        let mut file = EepromFile::open(&path, &mut bench, 0).unwrap();
        file.serve(&mut bench).unwrap();
        bench.board(0).avr_mut().set_eeprom(&[7]);
        bench.run_for_ms(2500);
        file.serve(&mut bench).unwrap();
        assert_eq!(fs::read(&path).unwrap()[0], 7);
    }

    #[test]
    fn a_file_of_another_size_is_rejected_and_stays() {
        let scratch = Scratch::new();
        let path = scratch.path("letter.txt");
        fs::write(&path, "dear").unwrap();
        let error = EepromFile::open(&path, &mut bench(), 0).err().unwrap().to_string();
        assert!(error.contains("has 4 bytes"), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"dear");
        assert!(EepromFile::open(&scratch.path("no/eeprom"), &mut bench(), 0).is_err());
    }
}
