//! Where the project's own firmware is, and what a board has after its first start with it.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use anyhow::{Result, ensure};

use crate::Bench;
use crate::board::Board;
use crate::can::SoftNode;
use crate::wiring::{Wiring, preset};

/// The EEPROM of a board that has been started once with this firmware, on a bus of the default bit rate. The first start may take its time, to make the board a
/// unique ID; what is of no concern to a test need not wait for that each time.
///
/// # Errors
/// If the file is missing, or is no program for a board that the simulator knows.
pub fn eeprom_after_first_start(elf: &Path) -> Result<Vec<u8>> {
    const FIRST_START_MS: u64 = 1500;
    let board = Board::load(elf)?;
    let bit_rate = board.wiring().fastest_bit_rate();
    let mut bench = Bench::new(bit_rate);
    let board = bench.add_board(board, "node");
    bench.attach("peer", Rc::new(RefCell::new(SoftNode::new(bit_rate))));
    bench.run_for_ms(FIRST_START_MS);
    Ok(bench.board(board).avr().eeprom())
}

/// The project's directory.
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// Cargo's target directory of this project.
pub fn target_dir() -> PathBuf {
    root().join(std::env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into()))
}

/// The board whose firmware [`node_elf`] and [`firmware`] look for: the one that the variables `NODE_BOARD` and `NODE_SHIELD` name, or the
/// table's default.
///
/// # Errors
/// If the table has no such board; the message says which there are.
pub fn chosen_board() -> Result<Wiring> {
    let chosen = |variable: &str, default: String| match std::env::var(variable) {
        Ok(name) if !name.is_empty() => name,
        _ => default,
    };
    let Wiring { board, shield, .. } = Wiring::default();
    Wiring::of(&chosen("NODE_BOARD", board), &chosen("NODE_SHIELD", shield))
}

/// Where the firmware is: `NODE_ELF`, else what `make firmware` leaves for the chosen board.
///
/// # Errors
/// See [`chosen_board`].
pub fn node_elf() -> Result<PathBuf> {
    match std::env::var_os("NODE_ELF").filter(|path| !path.is_empty()) {
        Some(path) => Ok(path.into()),
        None => chosen_board().map(|board| built(&board, &preset(board.chip))),
    }
}

/// Where the firmware of a preset is, such as "thesis", or of a list of features, such as "lights,stats", for the chosen board. That of the
/// preset of its chip is [`node_elf`].
///
/// # Errors
/// If it has not been built; the message says how to.
pub fn firmware(features: &str) -> Result<PathBuf> {
    let wiring = chosen_board()?;
    if features != preset(wiring.chip) {
        return firmware_for(&wiring.board, &wiring.shield, features);
    }
    let path = node_elf()?;
    ensure!(path.exists(), "{} is missing: run \"make firmware\"", path.display());
    Ok(path)
}

/// Where the firmware of a preset or of a list of features is for a board and a CAN board of `avr-specs/boards.toml`.
///
/// # Errors
/// If there is no such board, or the firmware has not been built; the message says which there are, or how to build it.
pub fn firmware_for(board: &str, shield: &str, features: &str) -> Result<PathBuf> {
    let path = built(&Wiring::of(board, shield)?, features);
    ensure!(
        path.exists(),
        "{} is missing: run \"make firmware BOARD={board} SHIELD={shield} FEATURES={features}\"",
        path.display()
    );
    Ok(path)
}

/// Where `make boot` leaves the bootloader of a board.
///
/// # Errors
/// If it has not been built; the message says how to.
pub fn bootloader(wiring: &Wiring) -> Result<PathBuf> {
    let Wiring { board, shield, .. } = wiring;
    let path = target_dir().join(format!("firmware/boot-{board}-{shield}.hex"));
    ensure!(path.exists(), "{} is missing: run \"make boot BOARD={board} SHIELD={shield}\"", path.display());
    Ok(path)
}

/// Where scripts/firmware leaves an ELF. The name of the chip's default preset is left out.
fn built(wiring: &Wiring, features: &str) -> PathBuf {
    let Wiring { board, shield, chip, .. } = wiring;
    let mut names: Vec<&str> = features.split(',').collect();
    names.sort_unstable();
    let names = names.join("+");
    let features = if names == preset(*chip) { String::new() } else { format!("-{names}") };
    target_dir().join(format!("firmware/{board}-{shield}{features}.elf"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_firmware_that_is_missing_is_named_with_what_builds_it() {
        let error = firmware("stats,no-such").unwrap_err().to_string();
        assert!(error.contains("firmware/diecimila-seeed-no-such+stats.elf is missing"), "{error}");
        assert!(
            error.ends_with("run \"make firmware BOARD=diecimila SHIELD=seeed FEATURES=stats,no-such\""),
            "{error}"
        );
        let error = firmware_for("nano", "sparkfun", "stats,no-such").unwrap_err().to_string();
        assert!(error.contains("firmware/nano-sparkfun-no-such+stats.elf is missing"), "{error}");
        let advice = "run \"make firmware BOARD=nano SHIELD=sparkfun FEATURES=stats,no-such\"";
        assert!(error.ends_with(advice), "{error}");
        let error = firmware_for("mega", "seeed", "full").unwrap_err().to_string();
        assert!(error.contains("use diecimila, "), "{error}");
    }

    #[test]
    fn the_preset_of_a_board_has_no_name_in_its_file() {
        let name = |board: &str, features: &str| {
            let path = built(&Wiring::of(board, "seeed").unwrap(), features);
            path.file_name().unwrap().to_string_lossy().into_owned()
        };
        assert_eq!(name("diecimila", "default"), "diecimila-seeed.elf");
        assert_eq!(name("diecimila", "full"), "diecimila-seeed-full.elf");
        assert_eq!(name("uno", "full"), "uno-seeed.elf");
        assert_eq!(name("uno", "default"), "uno-seeed-default.elf");
    }
}
