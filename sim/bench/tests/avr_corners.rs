//! Tests of a chip whose values are not the typical ones.

use std::cell::RefCell;
use std::rc::Rc;

use crate::avr::{MS, US, byte, program, word};
use bench::avr::{Avr, Oc, PulseMeter, ResetCause, Silicon};

fn chip(name: &str, silicon: Silicon) -> Avr {
    let mut avr = program(name, &[]);
    avr.set_silicon(silicon);
    avr
}

#[test]
fn pulses_and_characters_have_the_deviation_of_the_clock() {
    for (clock_ppm, period, character) in [(5_000, 79_602, 1_353), (-5_000, 80_402, 1_366)] {
        let silicon = Silicon { clock_ppm, ..Silicon::default() };
        let mut avr = chip("servo", silicon);
        avr.run_until(20 * MS);
        let pulses = PulseMeter::new().feed(avr.take_edges(Oc::B));
        assert_eq!(pulses[1].period_cycles, Some(period), "{pulses:?}");
        assert_eq!(avr.now() / MS, 20);

        let mut avr = chip("uart", silicon);
        avr.run_until(10 * MS);
        let sent = avr.serial_take();
        let apart = (sent[4].0 - sent[0].0) / 4;
        assert!(apart.abs_diff(character) <= 1, "{sent:?}");
        let rate = 16_000_000 * (1_000_000 + i64::from(clock_ppm)) / 136_000_000;
        assert!(avr.serial_sent_rate().abs_diff(rate as u64) <= 1);
    }
}

/// What is timed by the RC oscillator does not follow the main clock.
#[test]
fn eeprom_and_watchdog_take_their_times_whatever_the_clock() {
    for clock_ppm in [-20_000, 0, 20_000] {
        let silicon = Silicon {
            clock_ppm,
            eeprom_us: 3_740,
            watchdog_ppm: Some(100_000),
            ..Silicon::default()
        };
        let mut avr = chip("eeprom", silicon);
        avr.run_until(3_700 * US);
        assert_eq!(avr.eeprom()[7], 0xFF);
        avr.run_until(3_800 * US);
        assert_eq!(avr.eeprom()[7], 0x5A);

        let mut avr = chip("watchdog", silicon);
        avr.run_until(100 * MS);
        let at = avr.resets()[1].at;
        assert!(at.abs_diff(70_400 * US) < 100 * US, "{at}");
    }
}

/// An error of both ends of 4.1 %; each alone is within what the receiver tolerates.
#[test]
fn the_errors_of_both_ends_of_the_serial_port_add() {
    let echoed = |clock_ppm, line_ppm| {
        let mut avr = chip("uart", Silicon { clock_ppm, line_ppm, ..Silicon::default() });
        avr.set_serial_line_rate(Some(16_000_000 / 136));
        avr.run_until(10 * MS);
        avr.serial_take();
        avr.serial_send(b"abc");
        avr.run_until(20 * MS);
        avr.serial_take().into_iter().map(|(_, byte)| byte - 1).collect::<Vec<u8>>()
    };
    assert_eq!(echoed(-21_000, 0), b"abc");
    assert_eq!(echoed(0, 21_000), b"abc");
    assert_ne!(echoed(-21_000, 21_000), b"abc");
    assert_eq!(echoed(21_000, 21_000), b"abc");
}

/// > After all reset sources have gone inactive, a delay counter is invoked, stretching the
/// > internal reset. (DS40002061B, 11.1)
#[test]
fn the_program_starts_after_the_start_up_time_of_each_reset() {
    let silicon = Silicon { start_up_us: 70_000, ..Silicon::default() };
    let mut avr = chip("pins", silicon);
    let edges = Rc::new(RefCell::new(Vec::new()));
    let seen = Rc::clone(&edges);
    avr.watch_pin('B', 1, Box::new(move |_, at| seen.borrow_mut().push(at)));
    avr.run_until(80 * MS);
    avr.reset(ResetCause::External);
    avr.run_until(200 * MS);
    let edges = edges.borrow();
    assert!((70 * MS..70 * MS + 100 * US).contains(&edges[0]), "{}", edges[0]);
    let gap = edges.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
    assert!((70 * MS..70 * MS + 100 * US).contains(&gap), "{gap}");

    // The watchdog's shortest time-out of 16 ms begins when the program starts.
    let mut avr = chip("watchdog", silicon);
    avr.run_until(400 * MS);
    let at: Vec<u64> = avr.resets().iter().map(|reset| reset.at / MS).collect();
    assert!(at.windows(2).skip(1).all(|pair| (84..90).contains(&(pair[1] - pair[0]))), "{at:?}");
    assert_eq!(usize::from(byte(&avr, "starts")), avr.resets().len() - 1);
}

#[test]
fn the_adc_has_its_error_and_an_open_input_reads_noise() {
    let mut avr = chip("adc", Silicon { adc_offset: 2, is_floating: true, ..Silicon::default() });
    avr.run_until(MS);
    let mut open = |at| {
        avr.run_until(at * MS);
        word(&avr, "result")
    };
    let first = open(1);
    assert!((2..20).any(|at| open(at) != first));
    for (millivolts, result) in [(0, 2), (2500, 514), (5000, 1023)] {
        avr.set_analog(0, millivolts);
        avr.run_until(avr.now() + MS);
        assert_eq!(word(&avr, "result"), result);
    }
}

#[test]
fn an_open_input_reads_noise_and_one_with_a_pull_up_or_a_level_does_not() {
    let mut avr = chip("pins", Silicon { is_floating: true, ..Silicon::default() });
    avr.drive_pin('D', 2, false);
    let mut readings = (1..100).map(|step| {
        avr.run_until(step * 50 * US);
        byte(&avr, "pind")
    });
    let first = readings.next().unwrap();
    let changed = readings.fold(0, |changed, reading| changed | reading ^ first);
    assert_eq!(changed & 0b0001_1100, 0, "PD2 is low, PD3 and PD4 have pull-ups");
    assert_eq!(changed & 0b1110_0011, 0b1110_0011, "the others are open");
}

#[test]
#[should_panic(expected = "the chip has run already")]
fn the_values_of_a_chip_that_has_run_cannot_change() {
    let mut avr = program("spin", &[]);
    avr.run_until(MS);
    avr.set_silicon(Silicon::default());
}
