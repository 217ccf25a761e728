//! CANINTE, CANINTF, ICOD and the INT pin.

use super::support::*;
use can_model::Frame;

/// DS20001801J 7.0: INT is low while any enabled flag is set.
#[test]
fn int_is_low_while_an_enabled_flag_is_set() {
    let mut bench = Bench::new();
    for enabled in 0..8 {
        bench.write(CANINTE, &[1 << enabled]);
        for flag in 0..8 {
            bench.write(CANINTF, &[1 << flag]);
            assert_eq!(bench.int_is_low(), enabled == flag, "flag {flag}, enable {enabled}");
            bench.write(CANINTF, &[0]);
            assert!(!bench.int_is_low());
        }
    }
}

/// DS20001801J 7.0: INT is a level. It stays low until the last flag is cleared, and depends on
/// CANINTE.
#[test]
fn int_stays_low_until_all_flags_are_cleared() {
    let mut bench = Bench::new();
    bench.write(CANINTE, &[0x03]);
    bench.write(CANINTF, &[0x03]);
    bench.modify(CANINTF, 0x01, 0x00);
    assert!(bench.int_is_low());
    bench.write(CANINTE, &[0x01]);
    assert!(!bench.int_is_low());
    bench.write(CANINTE, &[0x02]);
    assert!(bench.int_is_low());
    bench.modify(CANINTF, 0x02, 0x00);
    assert!(!bench.int_is_low());
}

/// DS20001801J Table 7-1: a lower code has the higher priority; MERRF has no code.
#[test]
fn icod_shows_the_pending_interrupt_of_the_highest_priority() {
    let mut bench = Bench::new();
    bench.write(CANINTE, &[0xFF]);
    let by_priority = [(0x20, 1), (0x40, 2), (0x04, 3), (0x08, 4), (0x10, 5), (0x01, 6), (0x02, 7)];
    let mut pending = 0x80;
    bench.write(CANINTF, &[pending]);
    bench.assert_register(CANSTAT, 0x80);
    for (flag, code) in by_priority.into_iter().rev() {
        pending |= flag;
        bench.write(CANINTF, &[pending]);
        bench.assert_register(CANSTAT, 0x80 | code << 1);
    }
    for (flag, code) in by_priority {
        bench.assert_register(CANSTAT, 0x80 | code << 1);
        bench.modify(CANINTF, flag, 0);
    }
    bench.assert_register(CANSTAT, 0x80);
}

/// DS20001801J 7.1: ICOD shows enabled sources only.
#[test]
fn icod_ignores_sources_that_are_not_enabled() {
    let mut bench = Bench::new();
    bench.write(CANINTF, &[0xFF]);
    bench.assert_register(CANSTAT, 0x80);
    bench.write(CANINTE, &[0x02]);
    bench.assert_register(CANSTAT, 0x80 | 7 << 1);
}

/// DS20001801J 7.3: reception.
#[test]
fn a_received_frame_pulls_int_until_its_flag_is_cleared() {
    let mut bench = Bench::normal();
    bench.write(CANINTE, &[RX0IF]);
    bench.peer_sends(&[Frame::standard(1, &[1])]);
    assert!(bench.int_is_low());
    bench.assert_register(CANSTAT, 6 << 1);
    bench.spi(&[0x90, 0, 0, 0, 0, 0, 0]);
    assert!(!bench.int_is_low());
}

/// DS20001801J 7.2: transmission, for each buffer.
#[test]
fn a_sent_frame_pulls_int() {
    for n in 0..3u8 {
        let mut bench = Bench::normal();
        bench.write(CANINTE, &[TX0IF << n]);
        bench.load(n, 0x123, &[]);
        bench.rts(1 << n);
        bench.run_bits(FRAME_BITS);
        assert!(bench.int_is_low());
        bench.assert_register(CANSTAT, (3 + n) << 1);
    }
}

/// DS20001801J 7.4: an error during transmission or reception.
#[test]
fn a_message_error_pulls_int() {
    let mut bench = Bench::normal();
    bench.write(CANINTE, &[MERRF]);
    bench.bus.inject(can_model::Fault::FlipBit { bit: 20 });
    bench.peer_sends(&[Frame::standard(0x2AA, &[0xAA; 4])]);
    assert!(bench.int_is_low());
    assert_eq!(bench.read(CANINTF) & MERRF, MERRF);
    bench.modify(CANINTF, MERRF, 0);
    assert!(!bench.int_is_low());
}

/// DS20001801J 7.0: BIT MODIFY does not clear a flag that is set meanwhile.
#[test]
fn bit_modify_of_canintf_leaves_other_flags_alone() {
    let mut bench = Bench::normal();
    bench.write(RXB0CTRL, &[BUKT]);
    bench.peer_sends(&[Frame::standard(1, &[]), Frame::standard(2, &[])]);
    bench.modify(CANINTF, RX0IF, 0);
    bench.assert_register(CANINTF, RX1IF);
}
