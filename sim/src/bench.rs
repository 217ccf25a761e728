//! The bench: boards and other stations on one CAN bus, run in lock step.
//!
//! The bus tells how far the AVRs may run before it must be stepped (one bit while something goes
//! on, more while it is idle); each board runs there, then the bus follows, then the boards see
//! what became of their INT pins. A board is never ahead of the bus by more than that, and
//! overshoots it by one instruction at most.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use anyhow::{Result, ensure};

use crate::board::Board;
use crate::can::{Bus, PortId, SoftNode, StationRef};
use crate::wiring::{Wiring, preset};
use crate::{Cycles, F_CPU_HZ};

/// Boards and other stations on one bus.
pub struct Bench {
    boards: Vec<Board>,
    ports: Vec<PortId>,
    bus: Bus,
    now: Cycles,
}

impl Bench {
    /// An empty bus at that many bits per second.
    pub fn new(bit_rate: u32) -> Bench {
        Bench { boards: Vec::new(), ports: Vec::new(), bus: Bus::new(bit_rate), now: 0 }
    }

    /// Puts a board on the bus. Returns its number.
    pub fn add_board(&mut self, board: Board, name: &str) -> usize {
        self.ports.push(self.bus.attach(name, board.chip()));
        self.boards.push(board);
        self.boards.len() - 1
    }

    /// Puts another station on the bus.
    pub fn attach(&mut self, name: &str, station: StationRef) -> PortId {
        self.bus.attach(name, station)
    }

    /// Pulls a station's plug, for good.
    pub fn detach(&mut self, port: PortId) {
        self.bus.connect(port, false);
    }

    /// A board, by its number.
    pub fn board(&mut self, index: usize) -> &mut Board {
        &mut self.boards[index]
    }

    /// All boards.
    pub fn boards(&mut self) -> &mut [Board] {
        &mut self.boards
    }

    /// Where a board is connected to the bus.
    pub fn port(&self, index: usize) -> PortId {
        self.ports[index]
    }

    /// The bus, for faults, records and statistics.
    pub fn bus(&mut self) -> &mut Bus {
        &mut self.bus
    }

    /// The bench's time.
    pub fn now(&self) -> Cycles {
        self.now
    }

    /// Whether a debugger has halted a board: then nothing moves.
    pub fn is_halted(&self) -> bool {
        self.boards.iter().any(|board| board.avr().is_halted())
    }

    /// Runs everything until `t`, or until a debugger halts a board.
    pub fn run_until(&mut self, t: Cycles) {
        while self.now < t && !self.is_halted() {
            self.step(t);
        }
    }

    /// Runs until `condition` holds; false if it does not within `timeout` cycles.
    pub fn run_until_or(&mut self, mut condition: impl FnMut(&mut Bench) -> bool, timeout: Cycles) -> bool {
        let end = self.now + timeout;
        loop {
            if condition(self) {
                return true;
            }
            if self.now >= end || self.is_halted() {
                return false;
            }
            self.step(end);
        }
    }

    /// Runs for that many microseconds.
    pub fn run_for_us(&mut self, microseconds: u64) {
        self.run_until(self.now + microseconds * F_CPU_HZ / 1_000_000);
    }

    /// Runs for that many milliseconds.
    pub fn run_for_ms(&mut self, milliseconds: u64) {
        self.run_until(self.now + milliseconds * F_CPU_HZ / 1000);
    }

    fn step(&mut self, end: Cycles) {
        let horizon = self.bus.horizon().clamp(self.now + 1, end.max(self.now + 1));
        for board in &mut self.boards {
            board.run_until(horizon);
        }
        // The others wait, where they are, until the halted board has come to the horizon too.
        if self.is_halted() {
            return;
        }
        self.bus.run_until(horizon);
        for board in &self.boards {
            board.update_int();
        }
        self.now = horizon;
    }
}

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

/// Cargo's target directory of this project.
pub fn target_dir() -> PathBuf {
    let target = std::env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into());
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(target)
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
