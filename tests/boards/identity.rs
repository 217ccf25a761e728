//! The unique ID: the node generates it at its first start from the jitter between watchdog
//! oscillator and crystal, and keeps it in EEPROM. In the simulator a seed determines the jitter of
//! each chip.

use bench::Bench;
use bench::avr::{Avr, Firmware, ResetCause};
use bench::board::Board;
use rig::{MS, Program};

/// Position of the ID in the EEPROM (docs/parameters.md): 16 bytes, followed by their CRC and a
/// marker.
const ID: std::ops::Range<usize> = 4..20;
const RECORD: std::ops::Range<usize> = 4..23;

/// Longest duration of a first start, in milliseconds.
const FIRST_START_MS: u64 = 1500;

fn chip(seed: u64) -> Avr {
    let firmware =
        Firmware::read(&Program::Preset.elf()).unwrap_or_else(|error| panic!("{error:#}"));
    let mut avr = Avr::with_firmware(&firmware).unwrap();
    avr.seed(seed);
    avr.reset(ResetCause::PowerOn);
    avr
}
/// Starts a board with this EEPROM and returns the EEPROM after `ms` milliseconds.
/// A board that is started with this EEPROM, and what is there after so many milliseconds.
fn eeprom_after(seed: u64, eeprom: &[u8], ms: u64) -> Vec<u8> {
    let mut avr = chip(seed);
    avr.set_eeprom(eeprom);
    let mut bench = Bench::new(rig::board().fastest_bit_rate());
    let board = bench.add_board(Board::new(avr), "node");
    bench.run_for_ms(ms);
    let violations = bench.board(board).take_violations();
    assert!(violations.is_empty(), "driver mistakes: {violations:#?}");
    bench.board(board).avr().eeprom()
}

fn made(seed: u64) -> Vec<u8> {
    eeprom_after(seed, &[], FIRST_START_MS)
}

#[test]
fn two_boards_of_one_bench_generate_different_ids() {
    let mut bench = Bench::new(rig::board().fastest_bit_rate());
    for seed in [1, 2] {
        bench.add_board(Board::new(chip(seed)), "node");
    }
    bench.run_for_ms(FIRST_START_MS);
    let ids: Vec<_> =
        bench.boards().iter().map(|board| board.avr().eeprom()[ID].to_vec()).collect();
    assert_ne!(ids[0], ids[1]);
    let different = ids[0].iter().zip(&ids[1]).filter(|(a, b)| a != b).count();
    assert!(different >= 12, "{ids:x?}");
}

#[test]
#[ignore = "takes long: make test-all"]
fn boards_with_different_seeds_have_different_ids() {
    let ids: std::collections::HashSet<_> = (0..12).map(|seed| made(seed)[ID].to_vec()).collect();
    assert_eq!(ids.len(), 12);
    assert!(ids.iter().all(|id| id.iter().any(|&byte| byte != 0)));
}

#[test]
fn the_same_seed_gives_the_same_id() {
    assert_eq!(made(3)[RECORD], made(3)[RECORD]);
}

#[test]
fn a_stored_id_is_kept_by_the_next_start() {
    let first = made(4);
    // Another chip would generate another ID; with a stored ID it generates none.
    assert_eq!(eeprom_after(5, &first, 100), first);
    assert_eq!(first[RECORD.end - 1], 0, "the record's marker");
    let outside = first.iter().enumerate().filter(|(at, _)| !RECORD.contains(at));
    assert!(outside.into_iter().all(|(_, &byte)| byte == 0xFF), "no other byte is written");
}

#[test]
#[ignore = "takes long: make test-all"]
fn a_half_written_id_is_generated_again() {
    let written = made(6);
    // The node writes the record last, which takes 65 ms. An interrupted write leaves garbage.
    for cut_ms in [0, 1, 2, 5, 11, 20, 31, 44, 52] {
        let mut avr = chip(6);
        let started = (0..).map(|ms| ms * MS).find(|&at| {
            avr.run_until(at);
            avr.eeprom()[ID.start] != 0xFF
        });
        avr.run_until(started.unwrap() + cut_ms * MS);
        avr.reset(ResetCause::PowerOn);
        let cut = avr.eeprom();
        assert_ne!(cut[RECORD], written[RECORD], "cut after {cut_ms} ms");
        avr.run_until(avr.now() + FIRST_START_MS * MS);
        let after = avr.eeprom();
        assert_eq!(after[RECORD.end - 1], 0);
        assert_eq!(eeprom_after(7, &after, 100), after, "the second ID must be kept");
    }
}
