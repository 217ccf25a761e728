//! Bit timing.

use super::super::Mcp2515;
use super::script::run_all;
use super::support::*;
use can_model::Station;

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
    let mut chip = Mcp2515::new(8_000_000);
    spi_at(&mut chip, 1_000, &[WRITE, CNF3, 0x01, 0x91, 0x00]);
    spi_at(&mut chip, 1_000, &[WRITE, CANCTRL, NORMAL]);
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

#[test]
fn rules() {
    run_all(
        "
5.5: the rules are checked when configuration mode is left
    each $cnf $fault: 00+BC+00 PS2+is+shorter+than+2+TQ, 07+88+00 PropSeg+PS1+is+shorter+than+PS2, \
                      02+BC+80 PS2+is+not+longer+than+SJW, 00+00+00 above+1+Mbit/s
    CNF3 <- $cnf; request NORMAL; violation CNF1 $fault 5.5
5.5: the limits are legal: PS2 2 > SJW 1, PropSeg + PS1 = PS2, 25 TQ
    each $cnf: 01+91+00, 03+89+00, 07+BF+00, 04+BC+C0
    CNF3 <- $cnf; request NORMAL
5.5: one violation until configuration mode is entered again
    CNF3 <- 00 BC 00; request NORMAL; request LISTEN_ONLY; violation 5.5; enter LISTEN_ONLY
    enter CONFIGURATION; request NORMAL; violation 5.5
10.4: in loopback mode the chip is off the bus, so its bit rate does not matter
    CNF3 <- 00 00 00; enter LOOPBACK
5.0: nodes with different nominal bit rates cannot communicate
    set up; CNF3 <- 01 BC 00; enter NORMAL; queue 01234567#5A5A5A5A5A5A5A5A; bits 2000
    CANINTF & RX0IF|RX1IF|MERRF = MERRF; counts REC
10.3: a listener at the wrong rate detects errors, and does not disturb the bus
    set up; CNF3 <- 01 BC 00; enter LISTEN_ONLY; witness; peer 01234567#5A5A5A5A5A5A5A5A
    CANINTF & MERRF = MERRF; REC = 0; acknowledged
",
    );
}

/// DS20001801J 5.0: a fast crystal makes the bits short. 8.1: the timer counts its periods once the
/// crystal is stable, which no driver can know; so it makes no mistake before.
#[test]
fn a_crystal_has_its_deviation_and_its_time_to_settle() {
    const SETTLING: u64 = 160_000;
    const START_UP: u64 = 128;
    let mut chip = Mcp2515::new(16_000_000);
    chip.set_oscillator(1_000, SETTLING);
    let mut send = |bytes: &[u8], at| {
        let answer = spi_at(&mut chip, at, bytes);
        (answer, chip.take_violations().len())
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
