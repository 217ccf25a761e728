//! Compares the own core with simavr: the same program, board, bus and traffic on both, line by
//! line.
//!
//! `CROSS_SECONDS` is the simulated time of each program, 3 by default, and `CROSS_SEED` the seed
//! of the traffic. `make cross-check` runs longer than `make test`.

#[macro_use]
mod trace;

use bench::avr::{Avr, Engine, Firmware};
use bench::firmware_for;
use trace::{assert_equal, number};
use web::scenario::{self, Traffic};

#[track_caller]
fn compare(board: &str, preset: &str, traffic: &str) {
    let (seconds, seed) = (number("CROSS_SECONDS", 3), number("CROSS_SEED", 1));
    let elf = firmware_for(board, "seeed", preset).expect("the firmware");
    let firmware = Firmware::read(&elf).expect("an ELF file");
    let [own, simavr] = [Engine::Own, Engine::Simavr].map(|engine| {
        let chip = firmware.chip().expect("a known chip").unwrap_or_default();
        let avr = Avr::programmed_on(engine, chip, &firmware).expect("a program that fits");
        let kind = Traffic::named(traffic).expect("a traffic");
        scenario::run(avr, &firmware, kind, seconds, seed).expect("a possible wiring")
    });
    assert_equal(preset, ("own", &own), ("simavr", &simavr));
}

each_program!(compare);
