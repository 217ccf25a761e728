//! Modes of operation and the oscillator start-up timer; sleep.rs tests sleep.

use super::super::{Mcp2515, Mode};
use super::support::*;
use can_model::{Frame, Level, RecordKind, Station};

/// DS20001801J Registers 10-1 and 10-2: REQOP requests a mode, OPMOD shows it.
#[test]
fn every_mode_is_reached_from_configuration_mode() {
    for (reqop, mode) in [
        (NORMAL, Mode::Normal),
        (SLEEP, Mode::Sleep),
        (LOOPBACK, Mode::Loopback),
        (LISTEN_ONLY, Mode::ListenOnly),
    ] {
        let mut bench = Bench::in_mode(reqop);
        assert_eq!(bench.mode(), mode);
        bench.assert_register(CANCTRL, reqop | 0x07);
    }
}

/// DS20001801J 10.0: from each awake mode to each other one.
#[test]
fn every_awake_mode_is_reached_from_every_other() {
    let awake = [NORMAL, LOOPBACK, LISTEN_ONLY, CONFIGURATION];
    for from in awake {
        for to in awake {
            let mut bench = Bench::in_mode(from);
            bench.enter(to);
        }
    }
}

/// DS20001801J 10.0 and 10.5: normal and listen-only mode begin after 11 recessive bits.
#[test]
fn normal_mode_begins_after_eleven_recessive_bits() {
    for mode in [NORMAL, LISTEN_ONLY] {
        let mut bench = Bench::new();
        bench.set_up();
        bench.request(mode);
        let asked = bench.now;
        bench.run_to(asked + 10 * BIT);
        assert_eq!(bench.mode(), Mode::Configuration);
        bench.run_to(asked + 13 * BIT);
        assert_ne!(bench.mode(), Mode::Configuration);
    }
}

/// DS20001801J 10.0: the request waits for the end of another node's frame.
#[test]
fn normal_mode_waits_for_the_end_of_a_frame_on_the_bus() {
    let mut bench = Bench::new();
    bench.set_up();
    let witness = std::rc::Rc::new(std::cell::RefCell::new(can_model::SoftNode::new(1_000_000)));
    bench.bus.attach("witness", witness);
    bench.run_bits(50);
    bench.occupy_bus();
    bench.request(NORMAL);
    bench.run_bits(50);
    assert_eq!(bench.mode(), Mode::Configuration);
    bench.run_bits(100);
    assert_eq!(bench.mode(), Mode::Normal);
    bench.assert_register(CANINTF, 0);
}

/// DS20001801J 10.1: configuration mode does not wait if nothing is in progress.
#[test]
fn an_idle_chip_enters_configuration_mode_at_once() {
    for mode in [NORMAL, LISTEN_ONLY, LOOPBACK] {
        let mut bench = Bench::in_mode(mode);
        bench.request(CONFIGURATION);
        bench.assert_opmod(CONFIGURATION);
    }
}

/// DS20001801J 10.0: a frame in reception is completed first.
#[test]
fn a_frame_in_reception_is_finished_before_the_mode_changes() {
    for mode in [CONFIGURATION, LISTEN_ONLY, LOOPBACK, SLEEP] {
        let mut bench = Bench::normal();
        bench.occupy_bus();
        bench.request(mode);
        assert_eq!(bench.mode(), Mode::Normal);
        bench.run_bits(FRAME_BITS);
        bench.assert_opmod(mode);
        bench.assert_register(CANINTF, RX0IF);
    }
}

/// DS20001801J 10.0: "the mode will not actually change until all pending message transmissions are
/// complete".
#[test]
fn pending_transmissions_are_finished_before_the_mode_changes() {
    for mode in [CONFIGURATION, LISTEN_ONLY, LOOPBACK, SLEEP] {
        let mut bench = Bench::normal();
        bench.load(0, 0x111, &[1]);
        bench.load(1, 0x222, &[2]);
        bench.rts(0b011);
        bench.request(mode);
        bench.run_bits(60);
        assert_eq!(bench.mode(), Mode::Normal);
        bench.run_bits(FRAME_BITS);
        bench.assert_opmod(mode);
        assert_eq!(bench.peer_received().len(), 2);
    }
}

/// DS20001801J 3.6, 10.0: an unacknowledged frame delays the mode change until it is aborted.
#[test]
fn an_abort_completes_a_waiting_mode_change() {
    let mut bench = Bench::normal();
    bench.unplug_peer();
    bench.send(0x111, &[1]);
    bench.request(CONFIGURATION);
    bench.run_bits(1_000);
    assert_eq!(bench.mode(), Mode::Normal);
    bench.modify(CANCTRL, ABAT, ABAT);
    bench.run_bits(FRAME_BITS);
    bench.assert_opmod(CONFIGURATION);
}

/// A request that is ahead of the simulated bus takes effect at its own time: frames that ended
/// earlier are received.
#[test]
fn a_mode_request_has_no_effect_before_its_time() {
    let mut bench = Bench::normal();
    bench.write(RXB0CTRL, &[BUKT]);
    bench.occupy_bus();
    bench.peer.borrow_mut().send(Frame::standard(1, &[]));
    let asked = bench.now + 2 * FRAME_BITS * BIT;
    let mut chip = bench.chip.borrow_mut();
    chip.select(asked);
    for byte in [WRITE, CANCTRL, CONFIGURATION] {
        chip.end_byte(byte, asked);
    }
    chip.deselect(asked);
    drop(chip);
    bench.run_to(asked + BIT);
    bench.assert_opmod(CONFIGURATION);
    bench.assert_register(CANINTF, RX0IF | RX1IF);
}

/// DS20001801J 10.0: a request can be cancelled.
#[test]
fn a_request_for_the_present_mode_cancels_an_earlier_one() {
    let mut bench = Bench::normal();
    bench.occupy_bus();
    bench.request(CONFIGURATION);
    bench.request(NORMAL);
    bench.run_bits(FRAME_BITS);
    bench.assert_opmod(NORMAL);
    bench.request(CONFIGURATION);
    bench.request(NORMAL);
    bench.run_bits(FRAME_BITS);
    bench.assert_opmod(NORMAL);
}

/// DS20001801J Register 10-1: REQOP values 5 to 7 are invalid.
#[test]
fn an_invalid_mode_is_ignored_and_a_violation() {
    for reqop in [0xA0, 0xC0, 0xE0] {
        let mut bench = Bench::normal();
        bench.request(reqop);
        bench.run_bits(FRAME_BITS);
        bench.assert_opmod(NORMAL);
        bench.assert_violation(&["REQOP", "Register 10-1"]);
    }
}

/// DS20001801J 10.1: entering configuration mode clears the error counters.
#[test]
fn configuration_mode_clears_the_error_counters() {
    let mut bench = Bench::normal();
    bench.unplug_peer();
    bench.load(0, 0x111, &[1]);
    bench.write(TXB0CTRL, &[TXREQ]);
    bench.run_bits(500);
    bench.write(TXB0CTRL, &[0]);
    bench.run_bits(FRAME_BITS);
    assert_ne!(bench.read(TEC), 0);
    bench.enter(CONFIGURATION);
    bench.assert_register(TEC, 0);
}

/// DS20001801J 10.1: the chip neither sends nor receives in configuration mode; a request waits.
#[test]
fn a_request_made_in_configuration_mode_is_sent_in_normal_mode() {
    let mut bench = Bench::new();
    bench.set_up();
    bench.send(0x111, &[1]);
    bench.run_bits(FRAME_BITS);
    assert!(bench.peer_received().is_empty());
    bench.enter(NORMAL);
    bench.run_bits(FRAME_BITS);
    assert_eq!(bench.peer_received(), [Frame::standard(0x111, &[1])]);
}

/// DS20001801J 10.4: in loopback mode a frame goes from the transmit buffer through the filters to
/// the receive buffer, without the bus and without an acknowledgement.
#[test]
fn loopback_receives_its_own_frames_and_does_not_drive_the_bus() {
    let mut bench = Bench::in_mode(LOOPBACK);
    bench.load(2, 0x123, &[0xDE, 0xAD]);
    bench.rts(0b100);
    bench.run_bits(FRAME_BITS);
    bench.assert_register(CANINTF, RX0IF | TX0IF << 2);
    bench.assert_register(0x50, 0);
    assert_eq!(bench.read_many(RXB0SIDH, 7), [0x24, 0x60, 0, 0, 2, 0xDE, 0xAD]);
    assert!(bench.peer_received().is_empty());
    assert_eq!(bench.bus.stats().frames, 0);
    bench.assert_register(TEC, 0);
}

/// DS20001801J 10.4: the filters apply. A frame that they reject is still sent.
#[test]
fn loopback_applies_the_filters() {
    let mut bench = Bench::new();
    bench.set_up();
    bench.write(RXM0, &[0xFF, 0xE0, 0, 0, 0xFF, 0xE0, 0, 0]);
    bench.enter(LOOPBACK);
    bench.send(0x123, &[1]);
    bench.run_bits(FRAME_BITS);
    bench.assert_register(CANINTF, TX0IF);
}

/// DS20001801J 10.4: frames of other nodes are not received.
#[test]
fn loopback_does_not_receive_from_the_bus() {
    let mut bench = Bench::in_mode(LOOPBACK);
    bench.peer_sends(&[Frame::standard(0x123, &[1])]);
    bench.assert_register(CANINTF, 0);
    assert_ne!(bench.peer.borrow().tec(), 0, "no node acknowledges");
}

/// DS20001801J 3.2, 10.4: three frames are received in the order of their priority.
#[test]
fn loopback_takes_time_and_keeps_the_transmit_priority() {
    let mut bench = Bench::in_mode(LOOPBACK);
    bench.write(RXB0CTRL, &[BUKT]);
    bench.load(0, 0x100, &[]);
    bench.load(1, 0x101, &[]);
    bench.rts(0b011);
    let asked = bench.now;
    while bench.read(CANINTF) & RX0IF == 0 {}
    let bits = (bench.now - asked) / BIT;
    assert!((40..80).contains(&bits), "a frame took {bits} bits");
    bench.run_bits(FRAME_BITS);
    assert_eq!(bench.read_many(RXB0SIDH, 2), [0x20, 0x20]);
    assert_eq!(bench.read_many(RXB1SIDH, 2), [0x20, 0x00]);
}

/// A second node on the bus, which acknowledges.
fn add_witness(bench: &mut Bench) {
    let witness = std::rc::Rc::new(std::cell::RefCell::new(can_model::SoftNode::new(1_000_000)));
    bench.bus.attach("witness", witness);
    bench.run_bits(50);
}

/// DS20001801J 10.3: in listen-only mode the chip receives frames, and drives nothing. One that
/// nobody acknowledges is an invalid one.
#[test]
fn listen_only_receives_and_never_acknowledges() {
    let mut bench = Bench::in_mode(LISTEN_ONLY);
    bench.peer_sends(&[Frame::standard(0x123, &[1])]);
    assert_eq!(bench.read(CANINTF) & (MERRF | RX0IF), MERRF | RX0IF);
    let records = bench.bus.take_records();
    assert!(!records.is_empty());
    for record in records {
        assert!(!matches!(record.kind, RecordKind::Frame { acked: true, .. }), "{record:?}");
    }

    let mut bench = Bench::in_mode(LISTEN_ONLY);
    add_witness(&mut bench);
    bench.peer_sends(&[Frame::standard(0x123, &[1])]);
    bench.assert_register(CANINTF, RX0IF);
}

/// DS20001801J 10.3: filters, masks and RXM do not matter. The frames fill RXB0, and roll over.
#[test]
fn listen_only_receives_frames_that_the_filters_reject() {
    for mode in [NORMAL, LISTEN_ONLY] {
        let mut bench = Bench::new();
        bench.set_up();
        bench.write(RXM0, &[0xFF; 8]);
        bench.write(RXB0CTRL, &[BUKT]);
        bench.enter(mode);
        add_witness(&mut bench);
        bench.peer_sends(&[Frame::standard(0x123, &[1]), Frame::extended(0x1234, &[2])]);
        let expected = if mode == LISTEN_ONLY { RX0IF | RX1IF } else { 0 };
        bench.assert_register(CANINTF, expected);
    }
}

/// DS20001801J 10.3: a frame with an error is received, too, with the part that had arrived.
#[test]
fn listen_only_receives_a_broken_frame() {
    // SOF, identifier, RTR, IDE and r0, and the length. There are no stuff bits.
    let control = 1 + 11 + 3 + 4;
    let (in_length, in_second_byte) = (control - 3, control + 8);
    for (bit, mode, expected) in [
        (in_length, LISTEN_ONLY, MERRF),
        (in_second_byte, NORMAL, MERRF),
        (in_second_byte, LISTEN_ONLY, MERRF | RX0IF),
    ] {
        let mut bench = Bench::in_mode(mode);
        add_witness(&mut bench);
        bench.bus.inject(can_model::Fault::FlipBit { bit });
        bench.peer.borrow_mut().send(Frame::standard(0x555, &[0xAA; 4]));
        // The error flag follows. The frame is not repeated yet.
        bench.run_bits(u64::from(bit) + 15);
        bench.assert_register(CANINTF, expected);
        if expected & RX0IF != 0 {
            assert_eq!(bench.read_many(RXB0SIDH, 9), [0xAA, 0xA0, 0, 0, 4, 0xAA, 0, 0, 0]);
        }
    }
}

/// DS20001801J 10.3: in listen-only mode the chip sends no message, and the error counters are off.
#[test]
fn listen_only_sends_nothing_and_counts_no_errors() {
    let mut bench = Bench::in_mode(LISTEN_ONLY);
    bench.send(0x111, &[1]);
    bench.bus.inject(can_model::Fault::StuckDominant(true));
    bench.run_bits(300);
    bench.bus.clear_faults();
    bench.run_bits(FRAME_BITS);
    assert!(bench.peer_received().is_empty());
    bench.assert_register(REC, 0);
    bench.assert_register(TEC, 0);
    bench.assert_register(TXB0CTRL, TXREQ);
}

/// DS20001801J 8.1: the chip is held in reset for 128 oscillator periods after power-up.
#[test]
fn spi_is_ignored_and_a_violation_during_oscillator_start_up() {
    // 128 periods of a 16 MHz crystal are 128 cycles, of an 8 MHz one 256.
    for (osc_hz, start_up) in [(16_000_000, 128), (8_000_000, 256)] {
        for (at, works) in [(start_up - 1, false), (start_up, true)] {
            let mut chip = Mcp2515::new(osc_hz);
            chip.select(0);
            chip.end_byte(WRITE, at);
            chip.end_byte(CANINTE, at);
            chip.end_byte(0x55, at);
            chip.deselect(at);
            assert_eq!(chip.register(CANINTE), if works { 0x55 } else { 0x00 });
            let violations = chip.take_violations();
            assert_eq!(violations.is_empty(), works);
            assert!(violations.iter().all(|v| v.at == at && v.text.contains("8.1")));
        }
    }
}

/// DS20001801J 9.0: the RESET pin has the effect of the instruction, and starts the timer.
#[test]
fn a_hardware_reset_restores_registers_and_starts_the_timer() {
    let mut bench = Bench::normal();
    bench.write(CANINTE, &[0xFF]);
    let now = bench.now;
    bench.chip.borrow_mut().hardware_reset(now);
    assert_eq!(bench.mode(), Mode::Configuration);
    bench.spi(&[READ, CANSTAT, 0]);
    bench.assert_violation(&["start-up", "8.1"]);
    bench.run_bits(8);
    bench.assert_register(CANINTE, 0);
}

/// DS20001801J 8.1: the start-up timer runs after the RESET instruction, too.
#[test]
fn after_the_reset_instruction_spi_is_ignored_for_128_oscillator_periods() {
    let mut bench = Bench::normal();
    bench.spi(&[RESET]);
    bench.write(CNF3, &CNF_1M);
    bench.assert_violation(&["instruction 02h", "start-up", "8.1"]);
    bench.run_bits(8);
    assert_eq!(bench.read_many(CNF3, 3), [0; 3]);
    bench.write(CNF3, &CNF_1M);
    assert_eq!(bench.read_many(CNF3, 3), CNF_1M);
}

/// DS20001801J 8.1: with a crystal of 8 MHz an access 10 us after RESET is ignored, and one after
/// 16 us is not.
#[test]
fn a_slower_crystal_takes_longer_to_start_after_reset() {
    const US: u64 = 16;
    for (later_us, works) in [(10, false), (16, true)] {
        let mut chip = Mcp2515::new(8_000_000);
        let reset = 1000;
        chip.select(reset);
        chip.end_byte(RESET, reset);
        chip.deselect(reset);
        let at = reset + later_us * US;
        chip.select(at);
        for byte in [WRITE, CANINTE, 0x55] {
            chip.end_byte(byte, at);
        }
        chip.deselect(at);
        assert_eq!(chip.register(CANINTE) == 0x55, works, "{later_us} us");
        assert_eq!(chip.take_violations().is_empty(), works);
    }
}

/// DS20001801J 10.1: only configuration mode clears the error counters.
#[test]
fn loopback_mode_keeps_the_error_counters_and_configuration_mode_clears_them() {
    let mut bench = Bench::normal();
    bench.unplug_peer();
    bench.send(0x123, &[]);
    bench.run_bits(100);
    bench.modify(CANCTRL, ABAT, ABAT);
    bench.run_bits(FRAME_BITS);
    bench.modify(CANCTRL, ABAT, 0);
    let tec = bench.read(TEC);
    assert!(tec > 0);
    bench.enter(LOOPBACK);
    bench.assert_register(TEC, tec);
    bench.enter(NORMAL);
    bench.assert_register(TEC, tec);
    bench.enter(CONFIGURATION);
    bench.assert_register(TEC, 0);
}

/// DS20001801J 9.0: a reset aborts the frame on the bus; the bus recovers.
#[test]
fn a_reset_aborts_the_frame_on_the_bus() {
    let mut bench = Bench::normal();
    bench.load(0, 0x111, &[0x55; 8]);
    bench.rts(1);
    bench.run_bits(40);
    assert!(bench.chip.borrow().transmitting());
    bench.spi(&[RESET]);
    assert_eq!(bench.chip.borrow_mut().drive(bench.now), Level::Recessive);
    assert!(!bench.chip.borrow().transmitting());
    bench.run_bits(FRAME_BITS);
    assert!(bench.peer_received().is_empty());
    bench.assert_register(TXB0CTRL, 0);
}

/// The driver may be ahead of the bus.
#[test]
fn a_frame_goes_on_up_to_the_time_of_a_reset() {
    let mut bench = Bench::normal();
    bench.load(0, 0x111, &[0x55; 8]);
    bench.rts(1);
    bench.run_bits(40);
    let reset_at = bench.now + 10 * BIT;
    bench.chip.borrow_mut().hardware_reset(reset_at);
    assert_eq!(bench.chip.borrow().mode(), Mode::Configuration);
    bench.run_bits(9);
    assert!(bench.now < reset_at && bench.chip.borrow().transmitting());
    bench.run_bits(2);
    assert!(!bench.chip.borrow().transmitting());
    bench.run_bits(FRAME_BITS);
    assert!(bench.peer_received().is_empty());
}
