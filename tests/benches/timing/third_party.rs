//! Runs the firmwares of `tests/third-party/` in their loop that only receives.

use std::path::PathBuf;

use bench::board::Board;
use bench::{Bench, target_dir};
use rig::MS;
use rig::load::{Load, Meter, Sender};

/// Longer than the start of a firmware.
const BOOT_MS: u64 = 50;

/// A firmware with a third-party driver.
#[derive(Clone, Copy)]
pub enum ThirdParty {
    Mcp2515,
    Mcp25xx,
}

impl ThirdParty {
    fn elf(self) -> PathBuf {
        let file = match self {
            ThirdParty::Mcp2515 => "third-party-mcp2515-crate.elf",
            ThirdParty::Mcp25xx => "third-party-mcp25xx-crate.elf",
        };
        let path = target_dir().join("avr-atmega168/firmware").join(file);
        assert!(path.exists(), "{} is missing: run `make third-party`", path.display());
        path
    }
}

/// Measures such a firmware under a load.
pub fn receive(third_party: ThirdParty, load: Load, ms: u64) -> Meter {
    let mut board = Board::load(&third_party.elf()).unwrap_or_else(|error| panic!("{error:#}"));
    // D4 low selects reception only.
    board.press_button(true);
    let mut bench = Bench::new(1_000_000);
    bench.add_board(board, "third-party");
    let mut sender = Sender::attach(&mut bench, load);
    bench.run_for_ms(BOOT_MS);
    let mut meter = Meter::attach(bench.board(0));
    for _ in 0..ms {
        sender.feed(bench.now());
        let end = bench.now() + MS;
        bench.run_until(end);
        bench.bus().take_records();
        meter.collect(bench.board(0));
    }
    meter
}
