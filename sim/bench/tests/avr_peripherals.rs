//! Tests of the SPI, USART0, ADC, EEPROM and Timer1 of the simulated ATmega168, with programs that
//! use them.

use std::cell::RefCell;
use std::rc::Rc;

use crate::avr::{MS, US, assert_no_violation, assert_one_violation, byte, bytes, program, word};
use bench::avr::{Avr, Oc, PulseMeter, ResetCause, SpiByte};

/// Connects a device that answers each byte with its complement. Returns the bytes that the device
/// gets.
fn complementing_device(avr: &mut Avr) -> Rc<RefCell<Vec<SpiByte>>> {
    let seen = Rc::new(RefCell::new(Vec::new()));
    let log = Rc::clone(&seen);
    avr.connect_spi(Box::new(move |byte: &bench::avr::SpiByte| {
        log.borrow_mut().push(*byte);
        !byte.mosi
    }));
    seen
}

#[test]
fn spi_bytes_go_in_both_directions() {
    let mut avr = program("spi", &[]);
    let seen = complementing_device(&mut avr);
    avr.run_until(MS);
    assert_eq!(bytes(&avr, "received"), [0xFE, 0xFD, 0xFC, 0xFB]);
    let seen = seen.borrow();
    assert_eq!(seen.iter().map(|byte| byte.mosi).collect::<Vec<u8>>(), [1, 2, 3, 4]);
    assert!(
        seen.iter()
            .all(|byte| byte.end - byte.start == 16 && byte.cycles_per_bit == 2 && byte.mode == 0)
    );
    assert_no_violation(&mut avr);
}

#[test]
fn spi_clock_and_mode_are_those_of_the_registers() {
    let mut avr = program("spi", &["SPCR_BITS=(_BV(SPR0)|_BV(CPOL)|_BV(CPHA))", "SPSR_BITS=0"]);
    let seen = complementing_device(&mut avr);
    avr.run_until(MS);
    let seen = seen.borrow();
    assert!(
        seen.iter().all(|byte| byte.end - byte.start == 128
            && byte.cycles_per_bit == 16
            && byte.mode == 3)
    );
}

/// Datasheet 19.5.2: a write during a transfer has no effect but WCOL.
#[test]
fn spdr_written_during_a_transfer_is_ignored() {
    let mut avr = program("spi", &["COLLIDE"]);
    let seen = complementing_device(&mut avr);
    avr.run_until(MS);
    assert_eq!(seen.borrow().iter().map(|byte| byte.mosi).collect::<Vec<u8>>(), [1, 2, 3, 4]);
    assert_eq!(byte(&avr, "status") & 0b1100_0000, 0b1100_0000);
    assert_one_violation(&mut avr, "WCOL");
}

#[test]
fn ss_as_an_input_is_reported() {
    let mut avr = program("spi", &["NO_SS"]);
    avr.run_until(MS);
    let violations = avr.take_violations();
    assert_eq!(violations.len(), 4, "one for each byte");
    assert!(violations.iter().all(|violation| violation.text.contains("SS (PB2) is an input")));
}

/// 115200 baud with U2X and UBRR 16: 136 cycles per bit, ten bits per byte.
#[test]
fn serial_output_comes_at_the_configured_rate() {
    for defines in [&[][..], &["ISR_DRIVEN"]] {
        let mut avr = program("uart", defines);
        avr.run_until(10 * MS);
        let sent = avr.serial_take();
        assert_eq!(sent.iter().map(|(_, byte)| *byte).collect::<Vec<u8>>(), b"hello");
        assert!(sent.windows(2).all(|pair| pair[1].0 - pair[0].0 == 1360), "{sent:?}");
        assert_no_violation(&mut avr);
    }
}

#[test]
fn serial_input_arrives_byte_by_byte() {
    let mut avr = program("uart", &[]);
    avr.run_until(10 * MS);
    avr.serial_take();
    let message: Vec<u8> = (0..200).collect();
    avr.serial_send(&message);
    avr.run_until(11 * MS);
    let early = avr.serial_take();
    assert!((10..=11).contains(&early.len()), "{} bytes in 1 ms", early.len());
    avr.run_until(40 * MS);
    let echoed: Vec<u8> =
        early.into_iter().chain(avr.serial_take()).map(|(_, byte)| byte).collect();
    assert_eq!(echoed, message.iter().map(|byte| byte + 1).collect::<Vec<u8>>());
    assert_eq!(avr.serial_overruns(), 0);
}

#[test]
fn a_program_that_reads_too_late_loses_serial_input() {
    let mut avr = program("uart", &["SLOW"]);
    avr.run_until(10 * MS);
    avr.serial_send(&[b'x'; 100]);
    avr.run_until(100 * MS);
    assert!(avr.serial_overruns() > 50);
    assert_eq!(avr.serial_unsent(), 0);
}

#[test]
fn the_adc_gives_the_datasheet_s_value_in_13_adc_clocks() {
    let mut avr = program("adc", &[]);
    for (millivolts, expected) in
        [(0, 0), (2, 0), (3, 1), (5, 1), (200, 41), (2500, 512), (4999, 1023), (5000, 1023)]
    {
        avr.set_analog(0, millivolts);
        avr.run_until(avr.now() + MS);
        assert_eq!(word(&avr, "result"), expected, "{millivolts} mV");
    }
    let cycles = u64::from(word(&avr, "duration")) * 8;
    assert!((1664..1664 + 5 * US).contains(&cycles), "{cycles} cycles");
}

#[test]
fn adc_noise_is_bounded_and_repeatable() {
    let samples = || {
        let mut avr = program("adc", &[]);
        avr.set_analog(0, 1000);
        avr.set_analog_noise_uv(10_000, 7);
        let sample = |at| {
            avr.run_until(at * MS);
            word(&avr, "result")
        };
        (1..50).map(sample).collect::<Vec<u16>>()
    };
    let first = samples();
    assert!(first.iter().all(|value| (202..=207).contains(value)), "{first:?}");
    assert!(first.iter().any(|value| *value != first[0]));
    assert_eq!(first, samples());
}

/// The pulse width changes only at the start of a period, and is exact to the cycle.
#[test]
fn servo_pulses_are_exact_whenever_ocr1b_is_written() {
    let mut avr = program("servo", &[]);
    avr.run_until(1000 * MS);
    let pulses = PulseMeter::new().feed(avr.take_edges(Oc::B));
    assert!(pulses.len() > 190, "{}", pulses.len());
    for pulse in &pulses {
        assert!(pulse.width_cycles % (500 * 8) == 0, "{pulse:?}");
        assert!((1000 * 8..=4000 * 8).contains(&pulse.width_cycles), "{pulse:?}");
        assert!(pulse.period_cycles.is_none_or(|period| period == 10_000 * 8), "{pulse:?}");
    }
    assert!(
        (1000..=4000)
            .step_by(500)
            .all(|ticks| pulses.iter().any(|pulse| pulse.width_cycles == ticks * 8))
    );
    assert_no_violation(&mut avr);
}

#[test]
fn an_eeprom_write_takes_3_4_ms() {
    let mut avr = program("eeprom", &[]);
    avr.run_until(3 * MS);
    assert_eq!(avr.eeprom()[7], 0xFF);
    avr.run_until(10 * MS);
    assert_eq!(avr.eeprom()[7], 0x5A);
    assert_eq!(byte(&avr, "read_back"), 0x5A);
    let microseconds = u64::from(word(&avr, "duration")) / 2;
    assert!((3390..=3410).contains(&microseconds), "{microseconds} us");
    assert_no_violation(&mut avr);
}

#[test]
fn eeprom_access_during_a_write_has_no_effect_and_is_reported() {
    let mut avr = program("eeprom", &["HASTY"]);
    avr.run_until(10 * MS);
    assert_eq!(avr.eeprom()[7], 0x5A);
    let texts: Vec<String> =
        avr.take_violations().into_iter().map(|violation| violation.text).collect();
    assert_eq!(texts.len(), 2, "{texts:?}");
    assert!(
        texts[0].contains("read while it is written") && texts[1].contains("another goes on"),
        "{texts:?}"
    );
}

#[test]
fn an_eeprom_write_survives_a_reset_but_not_a_loss_of_power() {
    for (cause, survives) in [(ResetCause::External, true), (ResetCause::PowerOn, false)] {
        let mut avr = program("eeprom", &[]);
        avr.run_until(MS);
        avr.load_flash(0, &[0xFF, 0xCF]); // rjmp .-2: the program does not write again
        avr.reset(cause);
        avr.run_until(10 * MS);
        assert_eq!(avr.eeprom()[7] == 0x5A, survives, "{cause:?}");
    }
}
