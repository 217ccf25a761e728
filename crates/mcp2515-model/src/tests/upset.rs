//! Faults of the chip that the driver does not cause, and the driver's means against them.

use super::super::Mode;
use super::support::*;
use can_model::Frame;

/// The chip answers with garbage in its registers; RESET and a new set-up make it work.
#[test]
fn a_brown_out_leaves_garbage_by_its_seed_and_a_reset_restores_the_chip() {
    let mut seen = Vec::new();
    for seed in 0..16 {
        let mut bench = Bench::normal();
        bench.chip.borrow_mut().brown_out(seed, bench.now);
        seen.push((bench.mode(), bench.read(CANINTE)));
        bench.run_bits(500);
        bench.reset();
        bench.run_bits(300);
        bench.assert_opmod(CONFIGURATION);
        bench.set_up();
        bench.enter(NORMAL);
        bench.write(CANINTF, &[0]);
        bench.peer_sends(&[Frame::standard(0x321, &[2])]);
        bench.run_bits(4 * FRAME_BITS);
        bench.assert_register(CANINTF, RX0IF);
        bench.violations();
    }
    for mode in [Mode::Normal, Mode::Sleep, Mode::Loopback, Mode::ListenOnly, Mode::Configuration] {
        assert!(seen.iter().any(|(other, _)| *other == mode), "{mode:?} in {seen:?}");
    }
    assert!(seen.windows(2).any(|pair| pair[0].1 != pair[1].1));
}

#[test]
fn a_flipped_bit_changes_only_that_bit() {
    let mut bench = Bench::normal();
    let before = bench.read(CNF3);
    bench.chip.borrow_mut().flip_bits(CNF3, 0x02, bench.now);
    bench.assert_register(CNF3, before ^ 0x02);
    // A filter can be read in configuration mode only.
    bench.chip.borrow_mut().flip_bits(0x00, 0x81, bench.now);
    bench.enter(CONFIGURATION);
    bench.assert_register(0x00, 0x81);
}

#[test]
fn a_flipped_bit_of_the_requested_mode_changes_the_mode() {
    let mut bench = Bench::normal();
    bench.chip.borrow_mut().flip_bits(0x0F, 0x80, bench.now);
    bench.run_bits(20);
    bench.assert_opmod(CONFIGURATION);
}

#[test]
fn registers_that_only_the_chip_writes_do_not_flip() {
    let mut bench = Bench::normal();
    for address in [0x0E, 0x1C, 0x1D, 0x2D] {
        let before = bench.read(address);
        bench.chip.borrow_mut().flip_bits(address, 0xFF, bench.now);
        bench.assert_register(address, before);
    }
}

#[test]
fn a_reset_wakes_a_chip_that_fell_asleep() {
    let mut bench = Bench::normal();
    bench.chip.borrow_mut().fall_asleep(bench.now);
    bench.assert_opmod(SLEEP);
    bench.reset();
    bench.run_bits(10);
    bench.assert_opmod(CONFIGURATION);
}

#[test]
fn a_held_chip_stays_in_configuration_mode_until_it_is_released() {
    let mut bench = Bench::normal();
    bench.chip.borrow_mut().hold_in_configuration(true);
    bench.assert_opmod(CONFIGURATION);
    bench.request(NORMAL);
    bench.run_bits(100);
    bench.assert_opmod(CONFIGURATION);
    bench.reset();
    bench.set_up();
    bench.request(NORMAL);
    bench.run_bits(100);
    bench.assert_opmod(CONFIGURATION);
    bench.chip.borrow_mut().hold_in_configuration(false);
    bench.enter(NORMAL);
}
