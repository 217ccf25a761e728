//! Modes of operation and the oscillator start-up timer; sleep.rs tests sleep.

use super::super::{Mcp2515, Mode};
use super::script::run_all;
use super::support::*;
use can_model::{Frame, Level, Station};

#[test]
fn requests_of_a_mode() {
    run_all(
        "
Registers 10-1, 10-2: from configuration mode REQOP requests each mode, and OPMOD shows it
    each $mode $canctrl: NORMAL 07, SLEEP 27, LOOPBACK 47, LISTEN_ONLY 67
    in $mode; mode = $mode; CANCTRL = $canctrl
10.0, 10.1: each awake mode leads to each other; configuration mode and RESET (12.2) do not wait
    each $mode: NORMAL, LOOPBACK, LISTEN_ONLY
    in $mode; enter NORMAL; enter $mode; enter LOOPBACK; enter $mode; enter LISTEN_ONLY; enter $mode
    request CONFIGURATION; OPMOD = CONFIGURATION; enter $mode; reset; OPMOD = CONFIGURATION
10.0, 10.5: normal and listen-only mode begin after 11 recessive bits
    each $mode: NORMAL, LISTEN_ONLY
    set up; request $mode; bits 10; mode = CONFIGURATION; bits 3; mode = $mode
10.0: normal mode waits for the end of another node's frame
    set up; witness; busy; request NORMAL; bits 50; mode = CONFIGURATION; bits 100; mode = NORMAL
    CANINTF = 0
10.0: a frame in reception is completed first
    each $mode: CONFIGURATION, LISTEN_ONLY, LOOPBACK, SLEEP
    in NORMAL; busy; request $mode; mode = NORMAL; wait; OPMOD = $mode; CANINTF = RX0IF
10.0: \"the mode will not actually change until all pending message transmissions are complete\"
    each $mode: CONFIGURATION, LISTEN_ONLY, LOOPBACK, SLEEP
    in NORMAL; load 0 111#01; load 1 222#02; rts 3; request $mode; bits 60; mode = NORMAL; wait
    OPMOD = $mode; got 222#02 111#01
3.6, 10.0: an unacknowledged frame delays the mode change until it is aborted
    in NORMAL; unplug; send 111#01; request CONFIGURATION; bits 1000; mode = NORMAL
    modify CANCTRL ABAT ABAT; wait; OPMOD = CONFIGURATION
10.0: a request for the present mode cancels an earlier one
    in NORMAL; busy; request CONFIGURATION; request NORMAL; wait; OPMOD = NORMAL
    request CONFIGURATION; request NORMAL; wait; OPMOD = NORMAL
Register 10-1: REQOP values 5 to 7 are invalid
    each $reqop: A0, C0, E0
    in NORMAL; request $reqop; wait; OPMOD = NORMAL; violation REQOP Register 10-1
10.1: only configuration mode clears the error counters, which listen-only mode does not use
    in NORMAL; unplug; send 123#; bits 100; modify CANCTRL ABAT ABAT; wait; modify CANCTRL ABAT 0
    TEC = 10; enter LOOPBACK; TEC = 10; enter NORMAL; TEC = 10; enter CONFIGURATION; TEC = 0
10.1: a request made in configuration mode is sent in normal mode
    set up; send 111#01; wait; got; enter NORMAL; wait; got 111#01
",
    );
}

#[test]
fn loopback_and_listen_only() {
    run_all(
        "
10.4: loopback goes from the transmit to the receive buffer, without bus and acknowledgement
    in LOOPBACK; load 2 123#DEAD; rts 4; wait; CANINTF = RX0IF|TX2IF; TXB2CTRL = 0
    RXB0SIDH = 24 60 0 0 2 DE AD; got; TEC = 0
3.2, 10.4: a frame takes its time, and of three frames the order is that of their priority
    in LOOPBACK; RXB0CTRL <- BUKT; load 0 100#; load 1 101#; rts 3; bits 40; shows CANINTF 0
    bits 38; CANINTF & RX0IF = RX0IF; wait; RXB0SIDH = 20 20; RXB1SIDH = 20 00
10.4: the filters apply. A frame that they reject is still sent
    set up; RXM0 <- FF E0 0 0 FF E0 0 0; enter LOOPBACK; send 123#01; wait; CANINTF = TX0IF
10.4: frames of other nodes are not received, and not acknowledged
    in LOOPBACK; peer 123#01; CANINTF = 0; got; unacknowledged
10.3: a listening chip does not acknowledge. A frame that nobody acknowledges is invalid
    in LISTEN_ONLY; peer 123#01; CANINTF & MERRF|RX0IF = MERRF|RX0IF; unacknowledged
10.3: it receives frames, drives nothing and sends no message, and its error counters are off
    in LISTEN_ONLY; witness; send 111#01; peer 123#01; CANINTF = RX0IF; stuck; bits 300; free; wait
    got; REC = 0; TEC = 0; TXB0CTRL = TXREQ
10.3: in listen-only mode the filters do not matter. The frames fill RXB0, and roll over
    each $mode $received: NORMAL 0, LISTEN_ONLY RX0IF|RX1IF
    set up; RXM0 <- FF FF FF FF FF FF FF FF; RXB0CTRL <- BUKT; enter $mode; witness
    peer 123#01 00001234#02; CANINTF = $received
10.3: a listening chip receives a broken frame, too, with the part that had arrived
    each $mode $flags: NORMAL MERRF, LISTEN_ONLY MERRF|RX0IF
    in $mode; witness; flip 27; queue 555#AAAAAAAA; bits 42; CANINTF = $flags
10.3: ... of which there is none before the end of the length
    in LISTEN_ONLY; witness; flip 16; queue 555#AAAAAAAA; bits 31; CANINTF = MERRF
10.3: bytes that had not arrived are 0
    in LISTEN_ONLY; witness; flip 27; queue 555#AAAAAAAA; bits 42
    RXB0SIDH = AA A0 0 0 4 AA 0 0 0
",
    );
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
    bench.spi_at(asked, &[WRITE, CANCTRL, CONFIGURATION]);
    bench.run_to(asked + BIT);
    bench.assert_opmod(CONFIGURATION);
    bench.assert_register(CANINTF, RX0IF | RX1IF);
}

/// DS20001801J 8.1: the chip is held in reset for 128 oscillator periods after power-up and RESET:
/// 128 cycles with a 16 MHz crystal, 256 with an 8 MHz one. An access before that is a violation.
#[test]
fn spi_is_ignored_and_a_violation_during_oscillator_start_up() {
    for (osc_hz, start_up) in [(16_000_000, 128), (8_000_000, 256)] {
        for (reset, later, works) in [
            (None, start_up - 1, false),
            (None, start_up, true),
            (Some(1000), start_up - 1, false),
            (Some(1000), start_up, true),
        ] {
            let mut chip = Mcp2515::new(osc_hz);
            if let Some(at) = reset {
                spi_at(&mut chip, at, &[RESET]);
            }
            let at = reset.unwrap_or(0) + later;
            spi_at(&mut chip, at, &[WRITE, CANINTE, 0x55]);
            let what = format!("{osc_hz} Hz, {later} after {reset:?}");
            assert_eq!(chip.register(CANINTE), if works { 0x55 } else { 0x00 }, "{what}");
            let violations = chip.take_violations();
            assert_eq!(violations.is_empty(), works, "{what}");
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
    bench.assert_violation(&["instruction 03h", "start-up", "8.1"]);
    bench.run_bits(8);
    bench.assert_register(CANINTE, 0);
}

/// DS20001801J 9.0: a reset aborts the frame on the bus, at its time: the driver may be ahead of
/// the bus.
#[test]
fn a_reset_aborts_the_frame_on_the_bus() {
    for bits_ahead in [0, 10] {
        let mut bench = Bench::normal();
        bench.send(0x111, &[0x55; 8]);
        bench.run_bits(40);
        assert!(bench.chip.borrow().transmitting());
        let reset_at = bench.now + bits_ahead * BIT;
        bench.chip.borrow_mut().hardware_reset(reset_at);
        assert_eq!(bench.mode(), Mode::Configuration);
        if bits_ahead > 0 {
            bench.run_bits(bits_ahead - 1);
            assert!(bench.chip.borrow().transmitting());
            bench.run_bits(2);
        }
        assert_eq!(bench.chip.borrow_mut().drive(bench.now), Level::Recessive);
        assert!(!bench.chip.borrow().transmitting());
        bench.run_bits(FRAME_BITS);
        assert!(bench.peer_received().is_empty());
        bench.assert_register(TXB0CTRL, 0);
    }
}
