//! Programs about the timers give the datasheet's numbers (Atmel 2545, sections 15 to 18).

use std::cell::RefCell;
use std::rc::Rc;

use crate::avr::{MS, assert_no_violation, byte, bytes, program};
use bench::avr::{Avr, Oc, PulseMeter};

/// The edges of a pin, with their times.
type Edges = Rc<RefCell<Vec<(u64, bool)>>>;

/// The program of this macro, before it runs.
#[track_caller]
fn timers(define: &str) -> Avr {
    program("timers", &[define])
}

fn edges(avr: &mut Avr, port: char, bit: u8) -> Edges {
    let edges = Edges::default();
    let log = Rc::clone(&edges);
    avr.watch_pin(port, bit, Box::new(move |level, at| log.borrow_mut().push((at, level))));
    edges
}

/// Runs the program to its end. Returns what it measured.
#[track_caller]
fn results_of(avr: &mut Avr) -> [u16; 8] {
    avr.run_until(200 * MS);
    assert_eq!(byte(avr, "done"), 1, "the program does not end");
    let bytes = bytes(avr, "result");
    std::array::from_fn(|index| u16::from_le_bytes([bytes[2 * index], bytes[2 * index + 1]]))
}

#[track_caller]
fn results(define: &str) -> [u16; 8] {
    let mut avr = timers(define);
    let results = results_of(&mut avr);
    assert_no_violation(&mut avr);
    results
}

/// Times between the marks of the program, in CPU cycles.
#[track_caller]
fn times(define: &str) -> Vec<u64> {
    let mut avr = timers(define);
    let marks = edges(&mut avr, 'D', 7);
    results_of(&mut avr);
    assert_no_violation(&mut avr);
    let marks = marks.borrow();
    marks.windows(2).map(|pair| pair[1].0 - pair[0].0).collect()
}

/// Fails unless each time is within the cycles of a polling loop of the expected one.
#[track_caller]
fn assert_near(times: impl IntoIterator<Item = u64>, expected: &[u64]) {
    let times: Vec<u64> = times.into_iter().collect();
    assert_eq!(times.len(), expected.len(), "{times:?}");
    let near = times.iter().zip(expected).all(|(time, expected)| time.abs_diff(*expected) <= 14);
    assert!(near, "{times:?}, not {expected:?}");
}

/// Section 15.7.1: the counter counts from the value that was written, also to a stopped timer.
#[test]
fn a_preset_counter_overflows_after_the_rest_of_its_period() {
    let times = times("PRELOAD");
    assert_near([times[0], times[2], times[4]], &[100 * 64, 100 * 64, 1000 * 8]);
}

/// Table 15-9: with CS02:0 = 0 the timer is stopped, and its value can be read.
#[test]
fn a_stopped_counter_keeps_its_value() {
    let [t0, t1, t2, stopped0, stopped1, is_same, ..] = results("STOPPED");
    assert_eq!([t0, t1, t2, is_same], [12, 3456, 78, 1]);
    // 10 us are 160 cycles, and the three writes take a few.
    assert!((12 + 158..12 + 170).contains(&stopped0), "{stopped0}");
    assert_eq!(stopped1 - 3456, stopped0 - 12);
}

/// Table 16-4. ICR1 is not buffered, OCR1A is, in the PWM modes.
#[test]
fn timer1_has_the_period_of_its_mode_and_follows_a_change_of_top() {
    for (mode, before, after) in [
        (1, 510, 510),
        (5, 256, 256),
        (7, 1024, 1024),
        (8, 2000, 1000),
        (9, 2000, 1000),
        (10, 2000, 1000),
        (11, 2000, 1000),
        (14, 1001, 501),
        (15, 1001, 501),
    ] {
        let define = format!("PERIOD1={mode}");
        let mut avr = timers(&define);
        let marks = edges(&mut avr, 'D', 7);
        results_of(&mut avr);
        let marks = marks.borrow();
        let times: Vec<u64> = marks.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        assert_near(times[..3].iter().copied(), &[before; 3]);
        assert_near(times[6..].iter().copied(), &[after; 5]);
        // The chip ignores a write of ICR1 in the other modes.
        let has_icr1 = matches!(mode, 8 | 10 | 14);
        assert_eq!(avr.take_violations().is_empty(), has_icr1, "mode {mode}");
    }
}

/// Section 15.7.3, TOP in OCR0A.
#[test]
fn timer0_overflows_at_the_top_in_ocr0a() {
    assert_near(times("MODE7"), &[200 * 80 * 8]);
}

/// Programs that measure a few numbers, which are the same on every run. "Section 13.2: [...] if
/// enabled, the interrupts will trigger even if the [...] pins are configured as outputs."
#[test]
fn the_numbers_of_the_programs_are_those_of_the_datasheet() {
    let (oc1a, oc2a, oc0a) = (1 << 1, 1 << 3, 1 << 6);
    for (define, section, expected) in [
        // TIFR0 to TIFR2: the flag of TOP and no overflow. OCF0B, OCF1B and OCF2B too: OCRnB is 0.
        ("CTC", "15.7.2, 16.11.9", &[0b110, 0b10_0100, 0b110][..]),
        // 41 times 250 us; OC2B, which starts low, falls once a millisecond from the second one on.
        ("PIN_CHANGE", "13.2", &[10, 10, 9]),
        // A reset of the prescaler delays the next clock.
        ("PRESCALER", "17.2", &[0, 1, 1, 0]),
        // A forced compare changes the pin and nothing else; reading the pin.
        ("FORCE", "15.5.1, 15.6, 14.2.4", &[0, oc1a | oc2a, oc0a, 0, oc1a | oc2a, oc2a, oc0a]),
        // The cycle of a write and of a read of a running counter.
        ("CYCLES", "15.8, 7.6", &[0x30, 0x31, 0x32, 0x31]),
        // A write of the counter blocks the next match.
        ("BLOCKED", "15.5.2", &[0, 0b100]),
    ] {
        assert_eq!(results(define)[..expected.len()], *expected, "{define}: section {section}");
    }
}

/// Section 17.4.1.
#[test]
fn tsm_halts_the_timers_and_starts_them_together() {
    let [halted, t0, t1, t2, gtccr, released, ..] = results("SYNCHRONISED");
    assert_eq!(halted, 0);
    assert!((80..90).contains(&t0), "{t0}");
    assert_eq!([t1, t2], [t0, t0]);
    assert_eq!([gtccr, released], [0x83, 0]);
}

/// Sections 15.7.3, 15.7.4, 18.7.3.
#[test]
fn the_eight_bit_timers_make_pwm_on_their_pins() {
    let mut avr = timers("PWM");
    let [oc0b, oc2a, oc2b] = [('D', 5), ('B', 3), ('D', 3)].map(|(p, b)| edges(&mut avr, p, b));
    results_of(&mut avr);
    assert_no_violation(&mut avr);
    let mut widths = Vec::new();
    for pulse in PulseMeter::new().feed(oc0b.take()).into_iter().skip(1) {
        assert!(pulse.period_cycles.is_none_or(|period| period == 256 * 8), "{pulse:?}");
        widths.push(pulse.width_cycles);
    }
    // Only whole pulses of both widths: OCR0B + 1 clocks of 8 cycles.
    assert!(widths.iter().all(|width| [64 * 8, 128 * 8].contains(width)), "{widths:?}");
    assert!(widths.contains(&(64 * 8)) && widths.contains(&(128 * 8)));
    for (edges, ocr) in [(oc2a, 64), (oc2b, 32)] {
        let pulses = PulseMeter::new().feed(edges.take());
        assert!(pulses.len() > 10);
        for pulse in &pulses[1..] {
            assert_eq!((pulse.width_cycles, pulse.period_cycles), (2 * ocr * 8, Some(510 * 8)));
        }
    }
}

/// Sections 7.7 and 15.9.7.
#[test]
fn a_flag_is_kept_while_its_interrupt_is_masked() {
    let [_, all, after_sbi, after_cbi, after_interrupt, interrupts, ..] = results("MASKED");
    assert_eq!([all, after_sbi, after_cbi, after_interrupt], [0b111, 0b110, 0b110, 0b100]);
    assert_eq!(interrupts, 1);
}

/// Section 16.3.
#[test]
fn sixteen_bit_registers_are_read_and_written_as_one_value() {
    let mut avr = timers("TEMP");
    assert_eq!(results_of(&mut avr)[..4], [0, 0xABCD, 0x1234, 0]);
    crate::avr::assert_one_violation(
        &mut avr,
        "ICR1 is written in a mode that does not take TOP from it",
    );
}

/// Section 16.6.
#[test]
fn an_edge_on_icp1_captures_the_counter() {
    let [plain, with_canceler, other_edge, short, interrupts, ..] = results("CAPTURE");
    assert!((3..8).contains(&plain), "{plain}");
    assert_eq!(with_canceler, plain + 4);
    assert_eq!([other_edge, short], [with_canceler; 2]);
    assert_eq!(interrupts, 2);
}

#[test]
fn clocks_that_are_not_modelled_are_refused() {
    let mut avr = timers("REFUSED");
    let [stopped, running, ..] = results_of(&mut avr);
    assert_eq!(stopped, 0);
    assert!((150..200).contains(&running), "{running}");
    let texts: Vec<String> = avr.take_violations().into_iter().map(|v| v.text).collect();
    let parts = ["the clock of Timer0 is T0", "the clock of Timer1 is T1", "crystal (AS2)"];
    assert_eq!(texts.len(), parts.len(), "{texts:?}");
    assert!(texts.iter().zip(parts).all(|(text, part)| text.contains(part)), "{texts:?}");
}

/// Section 10.11.3.
#[test]
fn prr_stops_a_timer_and_its_registers() {
    let mut avr = timers("POWER");
    let [before, after, ..] = results_of(&mut avr);
    assert!((45..60).contains(&before) && (15..30).contains(&(after - before)), "{before} {after}");
    crate::avr::assert_one_violation(&mut avr, "a register of Timer2 is written while PRR stops");
}

/// Section 16.9.2: TOP in OCR1A changes at once.
#[test]
fn a_sleeping_program_wakes_at_each_compare_match() {
    let times = times("SLEEPING");
    assert_near(
        times[..8].iter().copied(),
        &[16_000, 16_000, 16_000, 8_000, 8_000, 8_000, 8_000, 8_000],
    );
}

/// The edges that are taken from the board have the times of those that a watcher gets.
#[test]
fn edges_of_timer1_are_the_same_for_watchers_and_for_the_board() {
    let mut avr = timers("PIN_CHANGE");
    let watched = edges(&mut avr, 'B', 1);
    results_of(&mut avr);
    let taken = avr.take_edges(Oc::A);
    assert!(taken.len() > 9);
    assert_eq!(*watched.borrow(), taken);
}
