//! Bit timing.

use super::support::*;
use can_model::{Frame, Station};

fn timed(cnf3_to_cnf1: [u8; 3]) -> Bench {
    let mut bench = Bench::new();
    bench.write(CNF3, &cnf3_to_cnf1);
    bench
}

/// Requests normal mode, in which the chip has a bit time, and returns it in picoseconds.
fn bit_time_ps(bench: &mut Bench) -> u64 {
    bench.request(NORMAL);
    bench.chip.borrow().bit_time_ps().expect("the chip is on the bus")
}

/// DS20001801J 5.0, Registers 5-1 to 5-3: bit rates and sample points from a 16 MHz crystal.
#[test]
fn cnf_registers_give_bit_time_and_sample_point() {
    for (cnf, bit_ps, permille) in [
        ([0x01, 0x91, 0x00], 1_000_000, 750),
        ([0x82, 0xD0, 0x00], 1_000_000, 625),
        ([0x01, 0xBC, 0x00], 2_000_000, 875),
        ([0x01, 0xBC, 0x01], 4_000_000, 875),
        ([0x01, 0xBC, 0x03], 8_000_000, 875),
        ([0x87, 0xFF, 0x3F], 200_000_000, 680),
    ] {
        let mut bench = timed(cnf);
        assert_eq!(bit_time_ps(&mut bench), bit_ps, "{cnf:02X?}");
        assert_eq!(bench.chip.borrow().sample_point_permille(), permille, "{cnf:02X?}");
    }
}

/// DS20001801J Register 5-2: without BTLMODE, PS2 is the greater of PS1 and 2 TQ.
#[test]
fn without_btlmode_ps2_follows_ps1() {
    // Prop 2, PS1 1 or 5. PHSEG2 is 8, without effect.
    for (cnf2, quanta) in [(0x01, 1 + 2 + 1 + 2), (0x21, 1 + 2 + 5 + 5)] {
        let mut bench = timed([0x07, cnf2, 0x01]);
        assert_eq!(bit_time_ps(&mut bench), quanta * 250_000);
    }
}

/// DS20001801J 5.0: the bit time scales with the crystal.
#[test]
fn an_8_mhz_crystal_doubles_the_bit_time() {
    let mut chip = super::super::Mcp2515::new(8_000_000);
    let at = 1_000;
    chip.select(at);
    for byte in [WRITE, CNF3, 0x01, 0x91, 0x00] {
        chip.end_byte(byte, at);
    }
    chip.deselect(at);
    chip.select(at);
    for byte in [WRITE, CANCTRL, NORMAL] {
        chip.end_byte(byte, at);
    }
    chip.deselect(at);
    assert_eq!(chip.bit_time_ps(), Some(2_000_000));
}

/// DS20001801J 10.1: a chip in configuration mode is not on the bus.
#[test]
fn there_is_no_bit_time_in_configuration_mode() {
    let mut bench = timed(CNF_1M);
    assert_eq!(bench.chip.borrow().bit_time_ps(), None);
    bench.enter(NORMAL);
    bench.enter(CONFIGURATION);
    assert_eq!(bench.chip.borrow().bit_time_ps(), None);
}

/// DS20001801J 5.5: the rules are checked when configuration mode is left.
#[test]
fn illegal_bit_timing_is_a_violation_on_leaving_configuration_mode() {
    for (cnf, fault) in [
        ([0x00, 0xBC, 0x00], "PS2 is shorter than 2 TQ"),
        ([0x07, 0x88, 0x00], "PropSeg + PS1 is shorter than PS2"),
        ([0x02, 0xBC, 0x80], "PS2 is not longer than SJW"),
        ([0x00, 0x00, 0x00], "above 1 Mbit/s"),
    ] {
        let mut bench = timed(cnf);
        bench.request(NORMAL);
        bench.assert_violation(&["CNF1", fault, "5.5"]);
    }
}

/// DS20001801J 5.5: the limits themselves are legal.
#[test]
fn bit_timing_at_the_limits_is_no_violation() {
    // PS2 2 > SJW 1, PropSeg + PS1 = PS2, 25 TQ.
    for cnf in [[0x01, 0x91, 0x00], [0x03, 0x89, 0x00], [0x07, 0xBF, 0x00], [0x04, 0xBC, 0xC0]] {
        timed(cnf).request(NORMAL);
    }
}

/// DS20001801J 5.5: one violation until configuration mode is entered again.
#[test]
fn illegal_bit_timing_is_reported_once() {
    let mut bench = timed([0x00, 0xBC, 0x00]);
    bench.request(NORMAL);
    bench.request(LISTEN_ONLY);
    assert_eq!(bench.violations().len(), 1);
    bench.enter(LISTEN_ONLY);
    bench.enter(CONFIGURATION);
    assert!(bench.violations().is_empty());
    bench.request(NORMAL);
    assert_eq!(bench.violations().len(), 1);
}

/// DS20001801J 10.4: in loopback mode the chip is off the bus, so its bit rate does not matter.
#[test]
fn loopback_may_be_faster_than_any_bus() {
    let mut bench = timed([0x00, 0x00, 0x00]);
    bench.enter(LOOPBACK);
}

/// DS20001801J 5.0: nodes with different nominal bit rates cannot communicate.
#[test]
fn a_chip_with_another_bit_rate_detects_errors_and_receives_no_frames() {
    let mut bench = Bench::new();
    bench.set_up();
    bench.write(CNF3, &CNF_500K);
    bench.enter(NORMAL);
    bench.peer.borrow_mut().send(Frame::extended(0x0123_4567, &[0x5A; 8]));
    bench.run_bits(2_000);
    assert_eq!(bench.read(CANINTF) & (RX0IF | RX1IF | MERRF), MERRF);
    assert_ne!(bench.read(REC), 0);
}

/// DS20001801J 10.3: a listener at the wrong rate detects errors and does not disturb the bus.
#[test]
fn a_listener_with_another_bit_rate_does_not_disturb() {
    let mut bench = Bench::new();
    bench.set_up();
    bench.write(CNF3, &CNF_500K);
    bench.enter(LISTEN_ONLY);
    let witness = std::rc::Rc::new(std::cell::RefCell::new(can_model::SoftNode::new(1_000_000)));
    bench.bus.attach("witness", witness.clone());
    bench.run_bits(50);
    let frame = Frame::extended(0x0123_4567, &[0x5A; 8]);
    bench.peer_sends(&[frame]);
    assert_eq!(witness.borrow_mut().take_received().len(), 1);
    assert_ne!(bench.read(CANINTF) & MERRF, 0);
    assert_eq!(bench.read(REC), 0);
}

/// DS20001801J 5.0: a fast crystal makes the bits short. 8.1: the timer counts its periods once the
/// crystal is stable, which no driver can know; so it makes no mistake before.
#[test]
fn a_crystal_has_its_deviation_and_its_time_to_settle() {
    const SETTLING: u64 = 160_000;
    const START_UP: u64 = 128;
    let mut chip = super::super::Mcp2515::new(16_000_000);
    chip.set_oscillator(1_000, SETTLING);
    let mut send = |bytes: &[u8], at| {
        chip.select(at);
        let exchange = |byte: &u8| {
            chip.begin_byte(at);
            chip.end_byte(*byte, at)
        };
        let answers: Vec<u8> = bytes.iter().map(exchange).collect();
        chip.deselect(at);
        (answers[answers.len() - 1], chip.take_violations().len())
    };
    let canstat = [READ, CANSTAT, 0];
    assert_ne!(send(&canstat, SETTLING - 1), (CONFIGURATION, 0));
    assert_eq!(send(&[RESET], SETTLING - 1).1, 0);
    assert_ne!(send(&canstat, SETTLING + START_UP - 1), (CONFIGURATION, 0));
    assert_eq!(send(&canstat, SETTLING + START_UP), (CONFIGURATION, 0));
    send(&[WRITE, CNF3, 0x01, 0x91, 0x00], SETTLING + START_UP);
    send(&[WRITE, CANCTRL, NORMAL], SETTLING + START_UP);
    assert_eq!(chip.bit_time_ps(), Some(999_000));
    assert_eq!(chip.bit_rate(), 1_000_000);
}
