//! Error counters, error states, bus-off and recovery in the registers.

use super::script::run_all;
use super::support::*;
use can_model::{ErrorState, Fault, Frame};

/// EFLG as Register 6-3 derives it from the counters.
fn expected_eflg(tec: u8, rec: u8) -> u8 {
    let mut eflg = 0;
    for (set, bits) in [
        (tec >= 96, TXWAR | EWARN),
        (rec >= 96, RXWAR | EWARN),
        (tec >= 128, TXEP),
        (rec >= 128, RXEP),
    ] {
        eflg |= if set { bits } else { 0 };
    }
    eflg
}

/// Runs bit by bit until `done`, and checks EFLG against TEC and REC in each bit. Returns all
/// values of EFLG.
#[track_caller]
fn watch(bench: &mut Bench, mut done: impl FnMut(u8, u8) -> bool) -> Vec<u8> {
    let mut seen = vec![];
    for _ in 0..10_000 {
        bench.run_bits(1);
        let [tec, rec, eflg] =
            [TEC, REC, EFLG].map(|address| bench.chip.borrow().register(address));
        if eflg & TXBO == 0 {
            assert_eq!(eflg, expected_eflg(tec, rec), "TEC {tec}, REC {rec}");
        }
        if seen.last() != Some(&eflg) {
            seen.push(eflg);
        }
        if done(tec, rec) {
            return seen;
        }
    }
    panic!("never done: EFLG took the values {seen:02X?}");
}

/// DS20001801J 6.7, Register 6-3: a lone sender becomes error-passive, and its TEC stops there (a
/// missing acknowledgement does not raise a passive node's TEC).
#[test]
fn a_lone_sender_becomes_error_passive_and_stays_on_the_bus() {
    let mut bench = Bench::normal();
    bench.unplug_peer();
    bench.send(0x123, &[]);
    let seen = watch(&mut bench, |tec, _| tec >= 128);
    assert_eq!(seen, [0, TXWAR | EWARN, TXWAR | EWARN | TXEP]);
    assert_eq!(bench.chip.borrow().error_state(), ErrorState::Passive);
    bench.run_bits(3_000);
    bench.assert_register(TEC, 128);
}

/// DS20001801J Register 6-3: the flags are cleared when the counter falls below the limit.
#[test]
fn error_flags_are_reset_below_their_limits() {
    let mut bench = Bench::normal();
    bench.unplug_peer();
    bench.send(0x123, &[]);
    watch(&mut bench, |tec, _| tec >= 128);
    bench.bus.connect(bench.peer_port, true);
    bench.run_bits(FRAME_BITS);
    bench.assert_register(TEC, 127);
    bench.assert_register(EFLG, TXWAR | EWARN);
    for _ in 0..32 {
        bench.rts(1);
        bench.run_bits(FRAME_BITS);
    }
    bench.assert_register(TEC, 95);
    bench.assert_register(EFLG, 0);
}

/// DS20001801J 6.7, Register 6-3: a receiver of destroyed frames.
#[test]
fn a_receiver_of_destroyed_frames_becomes_error_passive() {
    let mut bench = Bench::normal();
    bench.bus.inject(Fault::StuckDominant(true));
    let seen = watch(&mut bench, |_, rec| rec >= 128);
    assert_eq!(seen, [0, RXWAR | EWARN, RXWAR | EWARN | RXEP]);
    bench.bus.clear_faults();
    bench.run_bits(50);
    bench.peer_sends(&[Frame::standard(1, &[])]);
    assert_eq!(bench.read(EFLG) & RXEP, 0, "a valid frame makes it active again");
}

/// A dominant bus destroys the frame of a chip that is past arbitration, in which a dominant bit
/// would only mean another sender: the chip is bus-off within 31 x 8 bits. Then the bus works
/// again, and the frame is still pending.
#[test]
fn bus_off() {
    run_all(
        "
6.7, 7.6.6: TXBO is set when TEC passes 255. TEC has eight bits
    in NORMAL; send 123#5555555555555555; bits 30; stuck; bits 280; free; EFLG & TXBO = TXBO
    TEC = FF; CANINTF & ERRIF|MERRF = ERRIF|MERRF; TXB0CTRL & TXREQ = TXREQ
6.7, Figure 6-1: recovery after 128 times 11 recessive bits, with counters at 0; then the frame goes
    in NORMAL; send 123#5555555555555555; bits 30; stuck; bits 280; free; bits 1388
    EFLG & TXBO = TXBO; got; bits 240; EFLG = 0; TEC = 0; got 123#5555555555555555; OPMOD = NORMAL
9.0: a reset ends bus-off at once
    in NORMAL; send 123#5555555555555555; bits 30; stuck; bits 280; free; reset; EFLG = 0
    in NORMAL; send 124#; wait; got 124#
3.6, 10.0: without a pending frame configuration mode does not wait for the recovery
    in NORMAL; send 123#5555555555555555; bits 30; stuck; bits 280; free; request CONFIGURATION
    OPMOD = NORMAL; modify CANCTRL ABAT ABAT; OPMOD = CONFIGURATION; EFLG = 0
",
    );
}

/// DS20001801J 7.6: each change of the error state sets ERRIF, which can be cleared while
/// the state lasts.
#[test]
fn each_change_of_the_error_state_raises_errif() {
    let mut bench = Bench::normal();
    bench.unplug_peer();
    bench.send(0x123, &[]);
    watch(&mut bench, |tec, _| tec >= 88);
    assert_eq!(bench.read(CANINTF) & ERRIF, 0);
    watch(&mut bench, |tec, _| tec >= 96);
    for limit in [128, 128] {
        assert_eq!(bench.read(CANINTF) & ERRIF, ERRIF);
        bench.modify(CANINTF, ERRIF, 0);
        assert_eq!(bench.read(CANINTF) & ERRIF, 0);
        watch(&mut bench, |tec, _| tec >= limit);
    }
}
