//! The firmwares of `strangers/`, in their loop that only receives.

use std::path::PathBuf;

use bench::board::Board;
use bench::{Bench, target_dir};
use rig::MS;
use rig::load::{Load, Meter, Sender};

/// Longer than their start.
const BOOT_MS: u64 = 50;

/// A firmware with a third-party driver.
#[derive(Clone, Copy)]
pub enum Stranger {
    Mcp2515,
    Mcp25xx,
}

impl Stranger {
    fn elf(self) -> PathBuf {
        let file = match self {
            Stranger::Mcp2515 => "stranger-mcp2515-crate.elf",
            Stranger::Mcp25xx => "stranger-mcp25xx-crate.elf",
        };
        let path = target_dir().join("avr-atmega168/release").join(file);
        assert!(path.exists(), "{} is missing: run `make strangers`", path.display());
        path
    }
}

/// Results of such a firmware under a load.
pub fn receive(stranger: Stranger, load: Load, ms: u64) -> Meter {
    let mut board = Board::load(&stranger.elf()).unwrap_or_else(|error| panic!("{error:#}"));
    // D4 at ground: receive only.
    board.press_button(true);
    let mut bench = Bench::new(1_000_000);
    bench.add_board(board, "stranger");
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
