//! The paths of the project's own firmware, and the EEPROM of a board after its first start.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use anyhow::{Result, anyhow, bail, ensure};

use crate::Bench;
use crate::avr::Engine;
use crate::board::Board;
use crate::can::SoftNode;
use crate::corner::Corner;
use crate::wiring::{Wiring, preset};

/// The EEPROM of a board after its first start with a firmware, on a bus of the default bit rate.
/// At the first start the firmware makes a unique ID, which takes long. A test that begins with
/// this EEPROM need not wait for that.
///
/// # Errors
/// If the file is missing, or is not a program for a board that the simulator knows.
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

/// The board for [`node_elf`] and [`firmware`]: the one that the environment variables `NODE_BOARD`
/// and `NODE_SHIELD` name, by default that of `avr-specs/boards.toml`.
///
/// # Errors
/// If the table has no such board; the message lists those that it has.
pub fn chosen_board() -> Result<Wiring> {
    let chosen = |variable: &str, default: String| match std::env::var(variable) {
        Ok(name) if !name.is_empty() => name,
        _ => default,
    };
    let Wiring { board, shield, .. } = Wiring::default();
    Wiring::of(&chosen("NODE_BOARD", board), &chosen("NODE_SHIELD", shield))
}

/// What executes the programs of [`Board::programmed`]: the environment variable `NODE_PROCESSOR`,
/// "own" or "simavr", by default the engine's own default.
///
/// # Errors
/// If it has another name.
pub fn processor() -> Result<Engine> {
    match std::env::var("NODE_PROCESSOR").as_deref() {
        Err(_) | Ok("") => Ok(Engine::default()),
        Ok("own") => Ok(Engine::Own),
        Ok("simavr") => Ok(Engine::Simavr),
        Ok(other) => bail!("NODE_PROCESSOR is \"{other}\": use own or simavr"),
    }
}

/// The values of the boards of [`Board::in_corner`]: the environment variable `NODE_CORNER`, such
/// as "slow" or "random:7", by default the typical ones.
///
/// # Errors
/// If it has another name.
pub fn corner() -> Result<Option<Corner>> {
    let chosen = std::env::var("NODE_CORNER").ok().filter(|name| !name.is_empty());
    let parsed = chosen.map(|name| name.parse().map_err(|error| anyhow!("NODE_CORNER: {error}")));
    parsed.transpose()
}

/// The path of the node's firmware: the environment variable `NODE_ELF`, by default the file that
/// `make firmware` builds for the chosen board.
///
/// # Errors
/// Those of [`chosen_board`].
pub fn node_elf() -> Result<PathBuf> {
    match std::env::var_os("NODE_ELF").filter(|path| !path.is_empty()) {
        Some(path) => Ok(path.into()),
        None => chosen_board().map(|board| built(&board, &preset(board.chip))),
    }
}

/// The path of the firmware for the chosen board with a preset, such as "thesis", or a list of
/// features, such as "lights,stats". With the default preset of the chip it is [`node_elf`].
///
/// # Errors
/// If the file does not exist; the message says how to build it.
pub fn firmware(features: &str) -> Result<PathBuf> {
    let wiring = chosen_board()?;
    if features != preset(wiring.chip) {
        return firmware_for(&wiring.board, &wiring.shield, features);
    }
    let path = node_elf()?;
    ensure!(path.exists(), "{} is missing: run \"make firmware\"", path.display());
    Ok(path)
}

/// The path of the firmware for a board and a CAN board of `avr-specs/boards.toml`, with a preset
/// or a list of features.
///
/// # Errors
/// If the table has no such board, or the file does not exist; the message lists the boards, or
/// says how to build the file.
pub fn firmware_for(board: &str, shield: &str, features: &str) -> Result<PathBuf> {
    let path = built(&Wiring::of(board, shield)?, features);
    ensure!(
        path.exists(),
        "{} is missing: run \"make firmware BOARD={board} SHIELD={shield} FEATURES={features}\"",
        path.display()
    );
    Ok(path)
}

/// The path of the firmware with the default preset for a board, or of the same program that was
/// built for another board with its chip and CAN board.
///
/// # Errors
/// If there is none; the message says how to build it.
pub fn firmware_like(wiring: &Wiring) -> Result<PathBuf> {
    let Wiring { board, shield, chip, .. } = wiring;
    let likes = crate::boards::names("boards").filter_map(|name| Wiring::of(name, shield).ok());
    let built = likes.filter(|like| like.chip == *chip).map(|like| built(&like, &preset(*chip)));
    let own = firmware_for(board, shield, &preset(*chip));
    own.or_else(|missing| built.into_iter().find(|path| path.exists()).ok_or(missing))
}

/// The path of the bootloader that `make boot` builds for a board.
///
/// # Errors
/// If the file does not exist; the message says how to build it.
pub fn bootloader(wiring: &Wiring) -> Result<PathBuf> {
    let Wiring { board, shield, .. } = wiring;
    let path = target_dir().join(format!("firmware/boot-{board}-{shield}.hex"));
    ensure!(
        path.exists(),
        "{} is missing: run \"make boot BOARD={board} SHIELD={shield}\"",
        path.display()
    );
    Ok(path)
}

/// The path of an ELF file that scripts/firmware builds. The file name leaves out the default
/// preset of the chip.
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
    fn the_error_of_a_missing_firmware_says_how_to_build_it() {
        let error = firmware("stats,no-such").unwrap_err().to_string();
        assert!(error.contains("firmware/diecimila-seeed-no-such+stats.elf is missing"), "{error}");
        assert!(
            error.ends_with(
                "run \"make firmware BOARD=diecimila SHIELD=seeed FEATURES=stats,no-such\""
            ),
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
    fn the_file_name_leaves_out_the_default_preset_of_the_chip() {
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
