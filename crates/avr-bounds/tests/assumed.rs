//! Each assumption is in the report of the program that rests on it, with the address.

use std::fs;

use crate::support::build;
use avr_bounds::annotations::Annotations;
use avr_bounds::chip::Chip;
use avr_bounds::report::{Report, Scope};

const START: &str = "
    .global start
    .type start, @function
    start:
";

fn report(text: &str, annotations: &str, options: &[&str]) -> Report {
    let options = [&["-nostartfiles", "-nostdlib"], options].concat();
    let elf = build("assumed", "S", &format!("{START}{text}"), &options);
    let bytes = fs::read(&elf).unwrap();
    fs::remove_dir_all(elf.parent().unwrap()).unwrap();
    let annotations = Annotations::parse(annotations).unwrap();
    Report::of(&bytes, Chip::Atmega168, annotations, Scope::Everything).unwrap()
}

/// The assumptions of a program, each with its first place.
fn assumed(text: &str, annotations: &str, options: &[&str]) -> Vec<(String, String)> {
    let report = report(text, annotations, options);
    let printed = format!("{report}");
    let assumptions = report.assumptions.into_iter();
    assumptions
        .map(|mut assumption| {
            assert!(printed.contains(&format!("assumed: {}", assumption.text)), "{printed}");
            (assumption.text, assumption.places.remove(0))
        })
        .collect()
}

#[track_caller]
fn is_assumed(found: &[(String, String)], what: &str, place: &str) {
    let is_there = |(text, at): &(String, String)| text.contains(what) && at.starts_with(place);
    assert!(found.iter().any(is_there), "{what}: {found:?}");
}

#[test]
fn a_program_without_any_assumes_nothing() {
    assert_eq!(assumed("sts 0x100, r24\n1: rjmp 1b", "", &[]), []);
}

#[test]
fn a_store_of_a_pointer_that_is_not_known() {
    is_assumed(&assumed("nop\nst X, r24\n1: rjmp 1b", "", &[]), "through a pointer", "0x2");
}

#[test]
fn a_loader_that_writes_a_page() {
    let found = assumed("nop\nspm\njmp 0", "", &["-Wl,-Ttext=0x3800"]);
    is_assumed(&found, "SPM changes no code", "0x3802");
    is_assumed(&found, "the fuses", "0x3800");
}

#[test]
fn a_break() {
    is_assumed(&assumed("break\n1: rjmp 1b", "", &[]), "BREAK", "0x0");
}

#[test]
fn a_loop_that_an_annotation_bounds() {
    let annotations =
        "[[loop]]\nfunction = \"start\"\nnumber = 1\nat_most = 4\nreason = \"a test\"";
    let found = assumed(
        "nop\n1: lds r24, 0x100\ntst r24\nbrne 1b\n2: nop\nnop\nnop\nrjmp 2b",
        annotations,
        &[],
    );
    is_assumed(&found, "at most 4 rounds, because a test", "0x2");
    let annotations = "[[indirect]]\nfunction = \"start\"\ntargets = [\"f\"]\nreason = \"a test\"";
    let text = "icall\n1: rjmp 1b\n.type f, @function\nf: ret";
    is_assumed(&assumed(text, annotations, &[]), "names all targets: a test", "0x0");
}

#[test]
fn an_annotation_of_a_function_that_is_not_there_is_named() {
    let annotations = "
        [[loop]]
        function = \"start\"
        number = 1
        at_most = 255
        reason = \"it counts\"
        [[loop]]
        function = \"former\"
        number = 2
        at_most = 3
        reason = \"it counted\"
        [[turn]]
        kind = \"step\"
        calls = [\"gone\"]
    ";
    let text = "nop\n1: lds r24, 0x100\ntst r24\nbrne 1b\n2: nop\nnop\nnop\nrjmp 2b";
    let report = report(text, annotations, &[]);
    assert_eq!(report.unused, ["[[loop]] former 2", "[[turn]] step: gone"]);
    assert!(report.to_string().contains("say nothing about it: [[loop]] former 2, [[turn]]"));
}
