//! The unique ID: the node generates it at its first start from the jitter between watchdog
//! oscillator and crystal, and keeps it in EEPROM. In the simulator a seed determines the jitter of
//! each chip. allocation.rs has IDs of several boards, and cuts of the power.

use bench::Bench;
use bench::avr::{Avr, Firmware, ResetCause};
use bench::board::Board;
use rig::Program;

/// Position of the ID in the EEPROM (docs/parameters.md): 16 bytes, their CRC and a marker.
const RECORD: std::ops::Range<usize> = 4..23;

/// Starts a board of this seed with this EEPROM, and returns the EEPROM after `ms` milliseconds.
fn eeprom_after(seed: u64, eeprom: &[u8], ms: u64) -> Vec<u8> {
    let firmware =
        Firmware::read(&Program::Preset.elf()).unwrap_or_else(|error| panic!("{error:#}"));
    let mut avr = Avr::with_firmware(&firmware).unwrap();
    avr.seed(seed);
    avr.reset(ResetCause::PowerOn);
    avr.set_eeprom(eeprom);
    let mut bench = Bench::new(rig::board().fastest_bit_rate());
    let board = bench.add_board(Board::new(avr), "node");
    bench.run_for_ms(ms);
    let violations = bench.board(board).take_violations();
    assert!(violations.is_empty(), "driver mistakes: {violations:#?}");
    bench.board(board).avr().eeprom()
}

fn made(seed: u64) -> Vec<u8> {
    eeprom_after(seed, &[], 1500)
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
