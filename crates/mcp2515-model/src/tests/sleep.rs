//! Sleep and wake-up.

use super::super::Mode;
use super::support::*;
use can_model::Frame;

/// 128 periods of a 16 MHz crystal, in AVR cycles (DS20001801J 8.1).
const START_UP: u64 = 128;

fn asleep(wakie: bool) -> Bench {
    let mut bench = Bench::normal();
    bench.write(CANINTE, &[if wakie { WAKIF } else { 0 }]);
    bench.enter(SLEEP);
    bench
}

/// DS20001801J 10.2: the chip enters sleep when the bus is idle, not during a frame.
#[test]
fn sleep_waits_for_an_idle_bus() {
    let mut bench = Bench::normal();
    bench.occupy_bus();
    bench.request(SLEEP);
    bench.run_bits(50);
    assert_eq!(bench.mode(), Mode::Normal);
    bench.run_bits(FRAME_BITS);
    assert_eq!(bench.mode(), Mode::Sleep);
}

/// DS20001801J 10.2: registers can be accessed in sleep.
#[test]
fn registers_can_be_read_and_written_in_sleep() {
    let mut bench = asleep(true);
    bench.assert_opmod(SLEEP);
    bench.write(0x36, &[0x77]);
    bench.assert_register(0x36, 0x77);
    assert_eq!(bench.mode(), Mode::Sleep);
}

/// DS20001801J 7.5, 10.2.1: bus activity sets WAKIF, pulls INT, and after the start-up time the
/// chip is in listen-only mode.
#[test]
fn bus_activity_wakes_into_listen_only() {
    let mut bench = asleep(true);
    assert!(!bench.int_is_low());
    bench.peer.borrow_mut().send(Frame::standard(0x123, &[1]));
    bench.run_bits(2);
    let woken = bench.now;
    assert!(bench.int_is_low());
    assert_eq!(bench.chip.borrow().register(CANINTF), WAKIF);
    assert_eq!(bench.mode(), Mode::Sleep);
    bench.run_to(woken + START_UP + BIT);
    assert_eq!(bench.mode(), Mode::ListenOnly);
    bench.assert_opmod(LISTEN_ONLY);
}

/// DS20001801J 10.2.1: the message that woke the chip is not received.
#[test]
fn the_frame_that_wakes_the_chip_is_lost() {
    let mut bench = asleep(true);
    let witness = std::rc::Rc::new(std::cell::RefCell::new(can_model::SoftNode::new(1_000_000)));
    bench.bus.attach("witness", witness);
    bench.run_bits(50);
    bench.peer_sends(&[Frame::standard(0x123, &[1])]);
    bench.assert_register(CANINTF, WAKIF);
    bench.peer_sends(&[Frame::standard(0x124, &[1])]);
    bench.assert_register(CANINTF, WAKIF | RX0IF);
    bench.enter(NORMAL);
}

/// DS20001801J 10.2.1: without WAKIE bus activity does not wake the chip.
#[test]
fn without_wakie_the_chip_sleeps_through_traffic() {
    let mut bench = asleep(false);
    bench.peer_sends(&[Frame::standard(0x123, &[1])]);
    bench.assert_opmod(SLEEP);
    bench.assert_register(CANINTF, 0);
}

/// DS20001801J 10.2: the MCU wakes the chip by setting WAKIF while WAKIE is set.
#[test]
fn setting_wakif_wakes_the_chip() {
    let mut bench = asleep(true);
    bench.modify(CANINTF, WAKIF, WAKIF);
    bench.run_to(bench.now + START_UP);
    bench.assert_opmod(LISTEN_ONLY);
    bench.modify(CANINTF, WAKIF, 0);
    bench.enter(NORMAL);
    bench.peer_sends(&[Frame::standard(0x123, &[1])]);
    bench.assert_register(CANINTF, RX0IF);
}

/// DS20001801J 10.2: WAKIF alone does not wake the chip.
#[test]
fn setting_wakif_without_wakie_does_not_wake() {
    let mut bench = asleep(false);
    bench.modify(CANINTF, WAKIF, WAKIF);
    bench.run_bits(FRAME_BITS);
    bench.assert_opmod(SLEEP);
}

/// DS20001801J 8.1: no SPI operation until the start-up time has passed.
#[test]
fn spi_right_after_a_wake_up_by_the_driver_is_a_violation() {
    let mut bench = asleep(true);
    bench.modify(CANINTF, WAKIF, WAKIF);
    bench.write(CANINTE, &[0x00]);
    bench.assert_violation(&["start-up", "8.1"]);
    bench.run_bits(FRAME_BITS);
    bench.assert_register(CANINTE, WAKIF);
}

/// DS20001801J 10.2: a mode request does not wake the chip.
#[test]
fn a_mode_request_in_sleep_is_ignored_and_a_violation() {
    let mut bench = asleep(true);
    bench.request(NORMAL);
    bench.run_bits(FRAME_BITS);
    bench.assert_opmod(SLEEP);
    bench.assert_violation(&["asleep", "10.2"]);
}

/// DS20001801J 8.1, 9.0: RESET works in sleep and starts the oscillator.
#[test]
fn a_reset_wakes_the_chip_after_the_start_up_time() {
    let mut bench = asleep(true);
    bench.spi(&[RESET]);
    bench.run_to(bench.now + START_UP);
    bench.assert_opmod(CONFIGURATION);

    let mut bench = asleep(true);
    bench.spi(&[RESET]);
    bench.spi(&[READ, CANSTAT, 0]);
    bench.assert_violation(&["start-up"]);
}

/// DS20001801J 10.2: frames requested in sleep wait until normal mode.
#[test]
fn a_transmit_request_in_sleep_waits() {
    let mut bench = asleep(true);
    bench.send(0x111, &[]);
    bench.run_bits(FRAME_BITS);
    assert!(bench.peer_received().is_empty());
    bench.modify(CANINTF, WAKIF, WAKIF);
    bench.run_bits(FRAME_BITS);
    bench.enter(NORMAL);
    bench.run_bits(FRAME_BITS);
    assert_eq!(bench.peer_received().len(), 1);
}
