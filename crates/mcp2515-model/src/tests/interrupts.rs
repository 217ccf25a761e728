//! CANINTE, CANINTF, ICOD and the INT pin.

use super::script::run_all;
use super::support::*;

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

#[test]
fn int_and_icod() {
    run_all(
        "
7.0: INT is a level. It stays low until the last flag is cleared, and depends on CANINTE
    CANINTE <- 3; CANINTF <- 3; modify CANINTF 1 0; int low; CANINTE <- 1; int high
    CANINTE <- 2; int low; modify CANINTF 2 0; int high
7.1: ICOD shows enabled sources only
    CANINTF <- FF; CANSTAT = 80; CANINTE <- RX1IF; CANSTAT = 8E
7.3, 12.4: a received frame pulls INT until READ RX BUFFER clears its flag
    in NORMAL; CANINTE <- RX0IF; peer 001#01; int low; CANSTAT = 0C; spi 90 0 0 0 0 0 0; int high
7.2: a frame that was sent pulls INT
    each $n $rts $flag $canstat: 0 1 TX0IF 06, 1 2 TX1IF 08, 2 4 TX2IF 0A
    in NORMAL; CANINTE <- $flag; load $n 123#; rts $rts; wait; int low; CANSTAT = $canstat
7.4: an error during transmission or reception pulls INT
    in NORMAL; CANINTE <- MERRF; flip 20; peer 2AA#AAAAAAAA; int low; CANINTF & MERRF = MERRF
    modify CANINTF MERRF 0; int high
",
    );
}
