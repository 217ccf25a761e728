//! The stack: how deep it is, and the mistake of one that runs into variables or the heap.

use crate::avr::{MS, assert_no_violation, byte, firmware_for, program, with_firmware};
use bench::avr::{Avr, Chip, Firmware};

/// Bytes of a frame of `depth`: its variable, two registers, and the return address.
const FRAME: std::ops::RangeInclusive<u16> = 104..=106;

/// A program whose stack is watched, after a millisecond.
fn ran(defines: &[&str]) -> Avr {
    let mut avr = program("stack", defines);
    avr.watch_stack();
    avr.run_until(MS);
    avr
}

/// The text of the only mistake.
#[track_caller]
fn mistake(avr: &mut Avr) -> String {
    let mut all = avr.take_violations();
    assert_eq!(all.len(), 1, "{all:?}");
    all.remove(0).text
}

#[test]
fn the_deepest_stack_of_a_program_is_known_and_no_mistake() {
    let mut avr = ran(&["DEPTH=4"]);
    assert_eq!(byte(&avr, "done"), 2);
    let deepest = avr.deepest_stack().unwrap();
    let frames = 5 * FRAME.start()..=5 * FRAME.end() + 10;
    assert!(frames.contains(&deepest), "{deepest}");
    assert_no_violation(&mut avr);
    assert!(!avr.has_stack_overrun());
}

#[test]
fn a_stack_that_runs_into_a_variable_is_a_mistake_with_function_and_depth() {
    let mut avr = ran(&["DEPTH=6"]);
    assert_eq!(byte(&avr, "done"), 2, "the program itself does not notice");
    let text = mistake(&mut avr);
    assert!(text.starts_with("the stack runs into important, heap, done: "), "{text}");
    let deepest = avr.deepest_stack().unwrap();
    assert!(text.contains(&format!(": it is {deepest} bytes deep in depth, and ")), "{text}");
    assert!((7 * FRAME.start()..=7 * FRAME.end() + 10).contains(&deepest), "{text}");
    assert!(avr.has_stack_overrun());
    // The same again is not told for each push.
    avr.run_until(2 * MS);
    assert_no_violation(&mut avr);
}

/// The stack fits until the heap grows, which has the same bytes.
#[test]
fn a_stack_that_runs_into_the_heap_is_a_mistake() {
    assert_no_violation(&mut ran(&["DEPTH=4", "HEAP=10"]));
    let text = mistake(&mut ran(&["DEPTH=4", "HEAP=330"]));
    assert!(text.starts_with("the stack runs into the heap: it is 5"), "{text}");
}

#[test]
fn a_stack_through_all_of_the_ram_names_the_first_variables_and_the_registers() {
    let mut avr = ran(&["DEPTH=40"]);
    let all = avr.take_violations();
    let text = &all[0].text;
    assert!(text.starts_with("the stack runs into the registers, important, "), "{text}");
    assert!(text.contains("more: it is 1"), "{text}");
}

#[test]
fn a_program_with_several_stacks_makes_no_mistake() {
    let mut avr = ran(&["DEPTH=1", "TASK"]);
    assert_eq!(byte(&avr, "done"), 2);
    assert_no_violation(&mut avr);
    assert_eq!(avr.deepest_stack(), None);
}

#[test]
fn a_file_without_symbols_has_the_depth_and_its_variables_by_address() {
    let firmware = firmware_for(Chip::Atmega168, "stack", &["DEPTH=6"]);
    let Firmware { flash, statics, has_statics, .. } = firmware;
    for has_statics in [has_statics, false] {
        let stripped =
            Firmware { flash: flash.clone(), statics, has_statics, ..Default::default() };
        let mut avr = with_firmware(&stripped).unwrap();
        avr.watch_stack();
        avr.run_until(MS);
        assert!(avr.deepest_stack() > Some(700), "{:?}", avr.deepest_stack());
        match has_statics {
            true => assert!(mistake(&mut avr).contains("runs into the variables at 0x02")),
            false => assert_no_violation(&mut avr),
        }
    }
}
