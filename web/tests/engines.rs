//! Compares the own core with simavr: the same program, board, bus and traffic on both, line by
//! line.
//!
//! `CROSS_SECONDS` is the simulated time of each program, 3 by default, and `CROSS_SEED` the seed
//! of the traffic. `make cross-check` runs longer than `make test`.

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
    for kind in ["frame", "pulse", "serial", "eeprom"] {
        let count = simavr.lines().filter(|line| line.starts_with(kind)).count();
        println!("{board} {preset}: {count} {kind} lines");
        // The preset remote has no serial monitor.
        assert!(count > 0 || (kind, preset) == ("serial", "remote"), "no {kind}");
    }
    assert_equal(preset, ("own", &own), ("simavr", &simavr));
}

#[test]
fn default_runs_alike_on_both_engines() {
    compare("diecimila", "default", "ardupilot");
}

#[test]
fn remote_runs_alike_on_both_engines() {
    compare("diecimila", "remote", "px4");
}

#[test]
fn thesis_runs_alike_on_both_engines() {
    compare("diecimila", "thesis", "thesis");
}

#[test]
fn full_runs_alike_on_both_engines() {
    compare("uno", "full", "ardupilot");
}
