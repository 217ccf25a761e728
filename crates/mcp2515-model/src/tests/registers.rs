//! The register map.

use super::script::run_all;
use super::support::*;

#[test]
fn values() {
    run_all(
        "
Table 11-2 and the register descriptions: values after power-up. The RTS pins have pull-ups (3.5)
    BFPCTRL = 0 38 80 87; TEC = 0 0; RXM0 = 0 0 0 0 0 0 0 0 0 0 0 0 0 0 80 87; TXB0CTRL = 0
    TXB1CTRL = 0; TXB2CTRL = 0; RXB0CTRL = 0; RXB1CTRL = 0
Registers 3-3, 4-10: filters and buffers are \"unknown\" after a reset. Here they keep their values
    RXF3 <- 12 6A 56 78; TXB0SIDH <- 9A EB; reset; RXF3 = 12 6A 56 78; TXB0SIDH = 9A EB
Section 11: unimplemented and read-only bits stay 0. BUKT1 is a copy of BUKT. RTS pins are 0 (3-2)
    each $address $value: BFPCTRL 3F, TXRTSCTRL 07, CNF3 C7, CNF2 FF, CNF1 FF, CANINTE FF, 00 FF, \
                          01 EB, 02 FF, 11 EB, 21 E3, 25 E3, 27 FF, 31 FF, 32 EB, 45 4F, 5D FF, \
                          RXB0CTRL 66, RXB1CTRL 60, EFLG C0, CANINTF FF, TXB1CTRL 0B
    $address <- FF; $address = $value
10-2: CANSTAT is read-only. A sequential WRITE over it is no violation
    EFLG <- 00 FF 80; CANSTAT = 80 80
6-1, 6-2, 4-4 to 4-9: error counters and receive buffers are read-only
    each $address $name: TEC TEC, REC REC, 61 RXB0SIDH, 7D RXB1D7
    in NORMAL; RXB0CTRL <- BUKT; peer 001#0000000000000000 001#0000000000000000
    $address <- FF; $address = 0; violation $name read-only
4.5: masks and filters read as 0 outside configuration mode, but keep their values
    set up; RXF5 <- 11 0A 33 44; enter NORMAL; RXF5 = 0 0 0 0; enter CONFIGURATION
    RXF5 = 11 0A 33 44
5.7: the bit timing is readable in every mode
    in NORMAL; CNF3 = 01 91 00
12.3, Table 11-1: the address counter has seven bits
    00 <- 3C; 7F = 87 3C
Table 11-1: no addresses exist beyond 7Fh
    8F = 87; violation 8Fh Table 11-1
10.1: CNFn, TXRTSCTRL, filters and masks are writable in configuration mode only
    each $mode: NORMAL, LISTEN_ONLY, LOOPBACK, SLEEP
    in $mode; CNF1 <- 3; violation CNF1 03h 10.1; CNF1 = 0; CNF2 <- 3; violation CNF2 03h 10.1
    CNF2 = 91; CNF3 <- 3; violation CNF3 03h 10.1; CNF3 = 1; TXRTSCTRL <- 3
    violation TXRTSCTRL 03h 10.1; TXRTSCTRL = 38; 00 <- 3; violation RXF0SIDH 03h 10.1; shows 00 0
    1B <- 3; violation RXF5EID0 03h 10.1; shows 1B 0; RXM0 <- 3; violation RXM0SIDH 03h 10.1
    shows RXM0 0; 26 <- 3; violation RXM1EID8 03h 10.1; shows 26 0
",
    );
}

/// DS20001801J 9.0: RESET restores the same values, whatever was written.
#[test]
fn the_reset_instruction_restores_the_reset_values() {
    let mut bench = Bench::new();
    let before = bench.read_many(0x00, 128);
    for address in [BFPCTRL, TXRTSCTRL, CNF3, CNF2, CNF1, CANINTE, CANINTF, EFLG] {
        bench.write(address, &[0xFF]);
    }
    bench.write(RXM0, &[0xFF; 8]);
    bench.write(RXB0CTRL, &[0x64]);
    bench.write(CANCTRL, &[0x8F]);
    bench.reset();
    assert_eq!(bench.read_many(0x00, 128), before);
}

/// DS20001801J Table 11-1: CANSTAT and CANCTRL appear in all eight columns.
#[test]
fn canstat_and_canctrl_are_in_every_column() {
    let mut bench = Bench::new();
    for column in 0..8 {
        bench.write(column << 4 | 0x0F, &[0x80 | column]);
        for other in 0..8 {
            bench.assert_register(other << 4 | 0x0E, 0x80);
            bench.assert_register(other << 4 | 0x0F, 0x80 | column);
        }
    }
}
