//! Tests of Timer1 against the datasheet's sections 16.8 and 16.9. No program runs: the tests write
//! registers at chosen times.

use super::*;

const FAST_PWM_ICR1: (u8, u8) = (0b10, 0b11 << 3);
const FAST_PWM_OCR1A: (u8, u8) = (0b11, 0b11 << 3);
const CLEAR_B: u8 = 0b10 << 4;
const SET_B: u8 = 0b11 << 4;
const DIV_1: u8 = 1;
const DIV_8: u8 = 2;

fn write16(timer: &mut Timer1, low: u16, value: u16, now: Cycles) {
    let [low_byte, high_byte] = value.to_le_bytes();
    timer.write(low + 1, high_byte, now).unwrap();
    timer.write(low, low_byte, now).unwrap();
}

/// Timer1 started at cycle 0, with both pins as outputs, OCR1A 99, OCR1B 20, and ICR1 99 in modes
/// that use it.
fn started((tccr1a, tccr1b): (u8, u8), com: u8, clock: u8) -> Timer1 {
    let mut timer = Timer1::new(0);
    timer.set_port(0b110, 0, 0);
    write16(&mut timer, regs::OCR1AL, 99, 0);
    write16(&mut timer, regs::OCR1BL, 20, 0);
    timer.write(regs::TCCR1A, tccr1a | com, 0).unwrap();
    timer.write(regs::TCCR1B, tccr1b, 0).unwrap();
    if timer.mode().1 == Top::Icr1 {
        write16(&mut timer, regs::ICR1L, 99, 0);
    }
    timer.write(regs::TCCR1B, tccr1b | clock, 0).unwrap();
    timer
}

#[test]
fn fast_pwm_is_high_for_ocr_plus_one_clocks_of_top_plus_one() {
    for clock in [DIV_1, DIV_8] {
        let cycles_per_clock = PRESCALERS[usize::from(clock)];
        let mut timer = started(FAST_PWM_ICR1, CLEAR_B, clock);
        let edges = timer.take_edges(Oc::B, 300 * cycles_per_clock);
        let expected = [(100, true), (121, false), (200, true), (221, false), (300, true)];
        assert_eq!(edges, expected.map(|(clocks, level)| (clocks * cycles_per_clock, level)));
    }
}

#[test]
fn a_write_of_ocr1b_takes_effect_in_the_next_period() {
    let mut timer = started(FAST_PWM_ICR1, CLEAR_B, DIV_1);
    write16(&mut timer, regs::OCR1BL, 5, 110);
    write16(&mut timer, regs::OCR1BL, 40, 210);
    let edges = timer.take_edges(Oc::B, 399);
    assert_eq!(
        edges,
        [(100, true), (121, false), (200, true), (206, false), (300, true), (341, false)]
    );
}

#[test]
fn inverting_fast_pwm_is_low_for_ocr_plus_one_clocks() {
    let mut timer = started(FAST_PWM_ICR1, SET_B, DIV_1);
    assert_eq!(
        timer.take_edges(Oc::B, 230),
        [(21, true), (100, false), (121, true), (200, false), (221, true)]
    );
}

#[test]
fn fast_pwm_with_ocr_at_top_stays_high_and_with_ocr_zero_is_one_clock_wide() {
    let mut timer = started(FAST_PWM_ICR1, CLEAR_B, DIV_1);
    write16(&mut timer, regs::OCR1BL, 99, 50);
    assert_eq!(timer.take_edges(Oc::B, 450), [(100, true)]);
    write16(&mut timer, regs::OCR1BL, 0, 450);
    assert_eq!(timer.take_edges(Oc::B, 599), [(501, false)]);
    assert_eq!(timer.take_edges(Oc::B, 650), [(600, true), (601, false)]);
}

#[test]
fn top_from_ocr1a_is_double_buffered() {
    let mut timer = started(FAST_PWM_OCR1A, CLEAR_B, DIV_1);
    write16(&mut timer, regs::OCR1AL, 49, 110);
    let rises: Vec<Cycles> =
        timer.take_edges(Oc::B, 310).into_iter().filter(|edge| edge.1).map(|edge| edge.0).collect();
    assert_eq!(rises, [100, 200, 250, 300]);
}

#[test]
fn phase_correct_pwm_is_symmetric_about_bottom() {
    let mut timer = started((0b10, 0b10 << 3), CLEAR_B, DIV_1);
    // Up from 0: cleared after 20; down from 99: set after 20 again; period 198 clocks.
    assert_eq!(timer.take_edges(Oc::B, 400), [(179, true), (219, false), (377, true)]);
}

#[test]
fn ctc_toggles_oc1a_every_top_plus_one_clocks() {
    let mut timer = started((0, 0b01 << 3), 0b01 << 6, DIV_1);
    assert_eq!(timer.take_edges(Oc::A, 350), [(100, true), (200, false), (300, true)]);
}

#[test]
fn a_disconnected_pin_has_the_level_of_the_port_and_the_latch_is_kept() {
    let mut timer = started(FAST_PWM_ICR1, CLEAR_B, DIV_1);
    timer.write(regs::TCCR1A, FAST_PWM_ICR1.0, 110).unwrap();
    assert_eq!(timer.take_edges(Oc::B, 150), [(100, true), (110, false)]);
    assert_eq!(timer.output(Oc::B, 150), None);
    // No clear at 121: the latch does not change while COM1B is 0.
    timer.write(regs::TCCR1A, FAST_PWM_ICR1.0 | CLEAR_B, 160).unwrap();
    assert_eq!(timer.take_edges(Oc::B, 230), [(160, true), (221, false)]);
}

#[test]
fn a_pin_that_is_not_an_output_has_no_edges() {
    let mut timer = started(FAST_PWM_ICR1, CLEAR_B, DIV_1);
    timer.set_port(0, 0, 0);
    assert_eq!(timer.take_edges(Oc::B, 1000), []);
}

#[test]
fn the_prescaler_runs_freely_so_that_the_first_clock_can_come_early() {
    let mut timer = Timer1::new(0);
    timer.write(regs::TCCR1B, DIV_8, 13).unwrap();
    assert_eq!(timer.read(regs::TCNT1L, 15), 0);
    assert_eq!(timer.read(regs::TCNT1L, 16), 1);
    assert_eq!(timer.read(regs::TCNT1L, 24), 2);
}

#[test]
fn the_high_byte_waits_in_temp_for_the_low_byte() {
    let mut timer = Timer1::new(0);
    timer.write(regs::TCCR1B, DIV_1, 0).unwrap();
    write16(&mut timer, regs::TCNT1L, 0x12FE, 0);
    assert_eq!(timer.read(regs::TCNT1L, 1), 0xFF);
    assert_eq!(timer.read(regs::TCNT1H, 9), 0x12);
    assert_eq!(timer.read(regs::TCNT1L, 2), 0x00);
    assert_eq!(timer.read(regs::TCNT1H, 9), 0x13);
}

#[test]
fn icr1_cannot_be_written_in_a_mode_without_it() {
    let mut timer = Timer1::new(0);
    timer.write(regs::ICR1H, 1, 0).unwrap();
    assert!(timer.write(regs::ICR1L, 1, 0).is_err());
    assert_eq!(timer.icr1, 0);
}

#[test]
fn a_write_of_tcnt1_blocks_the_next_compare_match() {
    let mut timer = started(FAST_PWM_ICR1, CLEAR_B, DIV_1);
    timer.advance(110);
    write16(&mut timer, regs::TCNT1L, 20, 110);
    assert_eq!(timer.take_edges(Oc::B, 189), [(100, true)]);
}

#[test]
fn a_reset_makes_the_pin_an_input() {
    let mut timer = started(FAST_PWM_ICR1, CLEAR_B, DIV_1);
    timer.reset(105);
    assert_eq!(timer.take_edges(Oc::B, 1000), [(100, true), (105, false)]);
}
