//! Tests of the counter against the datasheet's sections 15.7 and 15.8 (Timer0), 16.9 and 16.10
//! (Timer1). No program runs: the tests set modes and step the time. What programs see is in
//! `sim/bench/tests/avr_timers.rs`.

use super::counter::{Counter, ICF, TOV};
use super::modes::Mode;
use sim_base::Cycles;

const CLEAR: u8 = 2;
const SET: u8 = 3;
const TOGGLE: u8 = 1;

/// Timer1 in a mode, with OCR1A `a`, OCR1B `b` and ICR1 99, started at cycle 0.
fn wide(wgm: u8, com: [u8; 2], [a, b]: [u16; 2], divider: u64) -> Counter {
    started(Counter::new(0xFFFF), Mode::of_16_bits(wgm), com, [a, b], divider)
}

/// Timer0 or Timer2 in a mode, started at cycle 0.
fn narrow(wgm: u8, com: [u8; 2], [a, b]: [u16; 2], divider: u64) -> Counter {
    started(Counter::new(0xFF), Mode::of_8_bits(wgm), com, [a, b], divider)
}

fn started(mut timer: Counter, mode: Mode, com: [u8; 2], ocr: [u16; 2], divider: u64) -> Counter {
    timer.set_ocr(0, ocr[0]);
    timer.set_ocr(1, ocr[1]);
    timer.set_icr(99);
    timer.configure(mode, com);
    timer.set_clock(divider, 0, 0);
    timer
}

/// Times up to `to` at which the timer sets all of these flags.
fn flags(timer: &mut Counter, flags: u8, to: Cycles) -> Vec<Cycles> {
    let mut times = Vec::new();
    while let Some(step) = timer.step(to) {
        if step.flags & flags == flags {
            times.push(step.at);
        }
    }
    times
}

/// Edges of OCnA (0) or OCnB (1) up to `to`.
fn edges(timer: &mut Counter, index: usize, to: Cycles) -> Vec<(Cycles, bool)> {
    let mut edges = Vec::new();
    while let Some(step) = timer.step(to) {
        if step.changed[index] {
            edges.push((step.at, timer.output(index).unwrap()));
        }
    }
    edges
}

fn count_at(timer: &mut Counter, at: Cycles) -> u16 {
    while timer.step(at).is_some() {}
    timer.count()
}

/// Section 15.7.2: a TOP below the counter is missed, and "the counter will then have to count to
/// its maximum value (0xFF) and wrap around starting at 0x00".
#[test]
fn a_top_below_the_counter_is_missed_until_after_max() {
    let mut timer = narrow(2, [0, 0], [99, 20], 1);
    assert_eq!(count_at(&mut timer, 50), 50);
    timer.set_ocr(0, 40);
    assert_eq!(flags(&mut timer, TOV, 1000), [256]);
    assert_eq!(count_at(&mut timer, 1001), (1001 - 256) % 41);
}

/// Section 16.11.9: ICF1 is set when the counter reaches the TOP that is in ICR1.
#[test]
fn top_in_icr1_sets_its_flag_in_modes_8_10_12_and_14() {
    for (wgm, period, first) in [(8, 198, 100), (10, 198, 100), (12, 100, 100), (14, 100, 100)] {
        let seen = flags(&mut wide(wgm, [0, 0], [500, 500], 1), ICF, 500);
        let expected: Vec<Cycles> = (first..=500).step_by(period).collect();
        assert_eq!(seen, expected, "mode {wgm}");
    }
    for wgm in [0, 1, 4, 5, 9, 11, 15] {
        assert_eq!(flags(&mut wide(wgm, [0, 0], [99, 99], 1), ICF, 5_000), [], "mode {wgm}");
    }
}

/// Table 16-4 and figure 16-12: the periods of all modes, and the clock that sets TOV.
#[test]
fn the_sixteen_modes_of_timer1_have_their_periods() {
    let periods: [(u8, u64, u64); 15] = [
        (0, 65_536, 65_536),
        (1, 510, 511),
        (2, 1022, 1023),
        (3, 2046, 2047),
        (4, 65_536, 65_536),
        (5, 256, 256),
        (6, 512, 512),
        (7, 1024, 1024),
        (8, 198, 199),
        (9, 2000, 2001),
        (10, 198, 199),
        (11, 2000, 2001),
        (12, 65_536, 65_536),
        (14, 100, 100),
        (15, 1001, 1001),
    ];
    for (wgm, period, first) in periods {
        let top_at_max = matches!(wgm, 4 | 12);
        let mut timer = wide(wgm, [0, 0], [if wgm == 4 { 0xFFFF } else { 1000 }, 7], 1);
        if top_at_max {
            timer.set_icr(0xFFFF);
        }
        // Buffered values are loaded in the first period; the counter starts with the old ones.
        let seen = flags(&mut timer, TOV, 300_000);
        assert_eq!(seen[2] - seen[1], period, "mode {wgm}: {:?}", &seen[..3]);
        if !matches!(wgm, 9 | 11 | 15) {
            assert_eq!(seen[0], first, "mode {wgm}");
        }
    }
}

/// Table 15-8, TOP in OCR0A with two slopes. Section 15.5.1: PWM modes have no forced compare.
#[test]
fn timer0_has_the_period_of_mode_5_and_no_forced_compare() {
    let mut timer = narrow(5, [TOGGLE, 0], [199, 7], 1);
    timer.force_compare(0);
    assert_eq!(timer.output(0), Some(false));
    let seen = flags(&mut timer, TOV, 5_000);
    assert_eq!(seen[3] - seen[2], 398);
}

#[test]
fn inverting_fast_pwm_is_low_for_ocr_plus_one_clocks() {
    let mut timer = wide(14, [0, SET], [99, 20], 1);
    assert_eq!(
        edges(&mut timer, 1, 230),
        [(21, true), (100, false), (121, true), (200, false), (221, true)]
    );
}

/// Section 16.9.3: "Setting the OCR1x equal to TOP will result in a constant high or low output";
/// "if the OCR1x is set equal to BOTTOM the output will be a narrow spike".
#[test]
fn fast_pwm_with_ocr_at_top_stays_high_and_with_ocr_zero_is_one_clock_wide() {
    let mut timer = wide(14, [0, CLEAR], [99, 20], 1);
    timer.set_ocr(1, 99);
    assert_eq!(edges(&mut timer, 1, 450), [(21, false), (100, true)][1..]);
    timer.set_ocr(1, 0);
    assert_eq!(edges(&mut timer, 1, 599), [(501, false)]);
    assert_eq!(edges(&mut timer, 1, 650), [(600, true), (601, false)]);
}

/// Section 16.9.4: the update is at TOP; 16.9.5: at BOTTOM.
#[test]
fn modes_with_two_slopes_update_ocr_at_top_or_at_bottom() {
    // Up from 0: cleared after 20; down from 99: set after 20 again; period 198 clocks.
    let mut timer = wide(10, [0, CLEAR], [0, 20], 1);
    assert_eq!(edges(&mut timer, 1, 400), [(179, true), (219, false), (377, true)]);
    for (wgm, next) in [(10, 198 - 30 + 1), (8, 198 - 20 + 1)] {
        let mut timer = wide(wgm, [0, CLEAR], [0, 20], 1);
        count_at(&mut timer, 50);
        timer.set_ocr(1, 30);
        assert_eq!(edges(&mut timer, 1, 190), [(next, true)], "mode {wgm}");
    }
}

/// Section 15.7.4: at OCRnx = BOTTOM the output stays low, at TOP high.
#[test]
fn phase_correct_pwm_is_constant_at_the_extremes() {
    let mut timer = narrow(1, [0, CLEAR], [0, 0], 1);
    assert_eq!(edges(&mut timer, 1, 2000), []);
    assert_eq!(timer.output(1), Some(false));
    let mut timer = narrow(1, [0, CLEAR], [0, 255], 1);
    assert_eq!(edges(&mut timer, 1, 2000), [(256, true)]);
}

/// Section 15.7.4: "OCRnx changes its value from MAX": the output falls at TOP without a match.
#[test]
fn phase_correct_pwm_restores_the_symmetry_at_top() {
    let mut timer = narrow(1, [0, CLEAR], [0, 255], 1);
    count_at(&mut timer, 300);
    timer.set_ocr(1, 100);
    // TOP is reached at 765: the next clock updates OCR0B and clears the output. 155 clocks later
    // the counter is at 100, and the clock after that sets it.
    assert_eq!(edges(&mut timer, 1, 1000), [(766, false), (921, true)]);
}

/// Tables 15-2, 16-1: toggle, clear and set in modes without PWM; 16-2, 16-3: COM1x1:0 = 1 in PWM
/// modes toggles OC1A in modes 9, 11, 14 and 15 only.
#[test]
fn compare_outputs_without_pwm_toggle_clear_and_set() {
    let mut timer = narrow(2, [TOGGLE, SET], [99, 20], 1);
    assert_eq!(edges(&mut timer, 0, 350), [(100, true), (200, false), (300, true)]);
    let mut timer = narrow(2, [TOGGLE, SET], [99, 20], 1);
    assert_eq!(edges(&mut timer, 1, 350), [(21, true)]);
    timer.configure(Mode::of_8_bits(2), [TOGGLE, CLEAR]);
    assert_eq!(edges(&mut timer, 1, 450), [(421, false)]);
    for wgm in 1..16 {
        let timer = wide(wgm, [TOGGLE, TOGGLE], [99, 20], 1);
        let is_pwm = !matches!(wgm, 4 | 12 | 13);
        assert_eq!(timer.is_connected(0), !is_pwm || matches!(wgm, 9 | 11 | 14 | 15), "{wgm}");
        assert_eq!(timer.is_connected(1), !is_pwm, "{wgm}");
    }
    let mut timer = wide(15, [TOGGLE, 0], [99, 20], 1);
    let rises: Vec<Cycles> = edges(&mut timer, 0, 450).iter().map(|edge| edge.0).collect();
    assert!(rises.windows(2).all(|pair| pair[1] - pair[0] == 100), "{rises:?}");
}

/// The time of the next event is that of the next step with an effect, or earlier, and never later.
#[test]
fn no_event_comes_before_the_time_that_is_announced() {
    for wgm in 0..16 {
        for ocr in [[0, 0], [5, 99], [99, 100], [1000, 3], [0xFFFF, 0x80]] {
            let mut timer = wide(wgm, [TOGGLE, CLEAR], ocr, 8);
            for _ in 0..1000 {
                let announced = timer.next_event().unwrap();
                assert_eq!(timer.clone().step(announced - 1), None, "mode {wgm}, {ocr:?}");
                timer.step(announced);
            }
        }
    }
}
