//! The register map.

use super::support::*;

/// DS20001801J Table 11-2 and the register descriptions: values after power-up.
#[test]
fn registers_have_their_reset_values() {
    let mut bench = Bench::new();
    for (address, value) in [
        (BFPCTRL, 0x00),
        (CANSTAT, 0x80),
        (CANCTRL, 0x87),
        (TEC, 0x00),
        (REC, 0x00),
        (CNF3, 0x00),
        (CNF2, 0x00),
        (CNF1, 0x00),
        (CANINTE, 0x00),
        (CANINTF, 0x00),
        (EFLG, 0x00),
        (TXB0CTRL, 0x00),
        (0x40, 0x00),
        (0x50, 0x00),
        (RXB0CTRL, 0x00),
        (RXB1CTRL, 0x00),
        // The three RTS pins are inputs with pull-ups (3.5).
        (TXRTSCTRL, 0x38),
    ] {
        bench.assert_register(address, value);
    }
    assert_eq!(bench.read_many(RXM0, 8), [0; 8], "masks");
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

/// DS20001801J Registers 3-3 and 4-10: filters and buffers are "unknown" after a reset. In the
/// model they keep their values, as RAM does.
#[test]
fn filters_and_buffers_survive_a_reset() {
    let mut bench = Bench::new();
    bench.write(RXF[3], &[0x12, 0x6A, 0x56, 0x78]);
    bench.write(TXB0SIDH, &[0x9A, 0xEB]);
    bench.reset();
    assert_eq!(bench.read_many(RXF[3], 4), [0x12, 0x6A, 0x56, 0x78]);
    assert_eq!(bench.read_many(TXB0SIDH, 2), [0x9A, 0xEB]);
}

/// DS20001801J section 11: unimplemented and read-only bits stay 0 when FFh is written.
#[test]
fn unimplemented_bits_read_as_zero() {
    let mut bench = Bench::new();
    for (address, value) in [
        (BFPCTRL, 0x3F),
        // Pins in request-to-send mode read as 0 (Register 3-2).
        (TXRTSCTRL, 0x07),
        (CNF3, 0xC7),
        (CNF2, 0xFF),
        (CNF1, 0xFF),
        (CANINTE, 0xFF),
        (0x00, 0xFF),
        (0x01, 0xEB),
        (0x02, 0xFF),
        (0x11, 0xEB),
        (0x21, 0xE3),
        (0x25, 0xE3),
        (0x27, 0xFF),
        (0x31, 0xFF),
        (0x32, 0xEB),
        (0x45, 0x4F),
        (0x5D, 0xFF),
        // BUKT1 is a copy of BUKT.
        (RXB0CTRL, 0x66),
        (RXB1CTRL, 0x60),
        (EFLG, 0xC0),
        (CANINTF, 0xFF),
    ] {
        bench.write(address, &[0xFF]);
        bench.assert_register(address, value);
    }
}

/// DS20001801J Register 3-1: only TXREQ and TXP of TXBnCTRL are writable.
#[test]
fn the_flags_of_txbnctrl_are_read_only() {
    let mut bench = Bench::new();
    bench.write(0x40, &[0xFF]);
    bench.assert_register(0x40, 0x0B);
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

/// DS20001801J Register 10-2: CANSTAT is read-only. A sequential WRITE over it is no violation.
#[test]
fn canstat_ignores_writes() {
    let mut bench = Bench::new();
    bench.write(EFLG, &[0x00, 0xFF, 0x80]);
    bench.assert_register(CANSTAT, 0x80);
    bench.assert_register(CANCTRL, 0x80);
}

/// DS20001801J Registers 6-1, 6-2, 4-4 to 4-9: error counters and receive buffers are read-only.
#[test]
fn a_write_to_a_read_only_register_is_ignored_and_a_violation() {
    for (address, name) in [(TEC, "TEC"), (REC, "REC"), (0x61, "RXB0SIDH"), (0x7D, "RXB1D7")] {
        let mut bench = Bench::new();
        let before = bench.read(address);
        bench.write(address, &[!before]);
        bench.assert_register(address, before);
        bench.assert_violation(&[name, "read-only"]);
    }
}

/// DS20001801J 10.1: CNFn, TXRTSCTRL, filters and masks are writable in configuration mode only.
#[test]
fn configuration_registers_reject_writes_in_other_modes() {
    for mode in [NORMAL, LISTEN_ONLY, LOOPBACK, SLEEP] {
        for (address, name) in [
            (CNF1, "CNF1"),
            (CNF2, "CNF2"),
            (CNF3, "CNF3"),
            (TXRTSCTRL, "TXRTSCTRL"),
            (0x00, "RXF0SIDH"),
            (0x1B, "RXF5EID0"),
            (0x20, "RXM0SIDH"),
            (0x26, "RXM1EID8"),
        ] {
            let mut bench = Bench::in_mode(mode);
            let before = bench.chip.borrow().register(address);
            bench.write(address, &[0x03]);
            bench.assert_violation(&[name, "03h", "10.1"]);
            assert_eq!(bench.chip.borrow().register(address), before, "{name} in {mode:02X}h");
        }
    }
}

/// DS20001801J 4.5: masks and filters read as 0 outside configuration mode, but keep their values.
#[test]
fn filters_and_masks_read_as_zero_outside_configuration_mode() {
    let mut bench = Bench::new();
    bench.set_up();
    bench.write(RXF[5], &[0x11, 0x0A, 0x33, 0x44]);
    bench.enter(NORMAL);
    assert_eq!(bench.read_many(RXF[5], 4), [0; 4]);
    bench.enter(CONFIGURATION);
    assert_eq!(bench.read_many(RXF[5], 4), [0x11, 0x0A, 0x33, 0x44]);
}

/// DS20001801J 5.7: the bit timing is readable in every mode.
#[test]
fn cnf_registers_are_readable_in_normal_mode() {
    let mut bench = Bench::normal();
    assert_eq!(bench.read_many(CNF3, 3), CNF_1M);
}

/// DS20001801J 12.3 and Table 11-1: the address counter has seven bits.
#[test]
fn a_sequential_read_wraps_from_7f_to_00() {
    let mut bench = Bench::new();
    bench.write(0x00, &[0x3C]);
    assert_eq!(bench.read_many(0x7F, 2), [0x87, 0x3C]);
}

/// DS20001801J Table 11-1: no addresses exist beyond 7Fh.
#[test]
fn an_address_beyond_the_map_is_a_violation() {
    let mut bench = Bench::new();
    assert_eq!(bench.read(0x8F), 0x87, "only seven address bits exist");
    bench.assert_violation(&["8Fh", "Table 11-1"]);
}
