//! Tests of `sim bounds`.

use bench::{node_elf, root};

use crate::links::sim;

#[test]
fn the_stack_and_the_handlers_of_the_node_are_printed() {
    let (elf, annotations) =
        (node_elf().expect("a firmware"), root().join("avr-specs/bounds.toml"));
    let [elf, annotations] = [&elf, &annotations].map(|path| path.to_str().expect("text"));
    let (code, text, error) = sim(&["bounds", elf, "--annotations", annotations]);
    assert_eq!(code, Some(0), "{error}");
    for part in ["stack at its deepest: ", " + INT0 ", "handler of INT0: ", "INT0 blocked for "] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn a_handler_with_a_loop_without_a_bound_is_refused_with_the_place_and_the_remedy() {
    let elf = node_elf().expect("a firmware");
    let (code, _, error) = sim(&["bounds", elf.to_str().expect("text")]);
    assert_eq!(code, Some(3));
    for part in ["in fetch: loop 1 has no bound", "[[loop]]", "--annotations"] {
        assert!(error.contains(part), "{part}: {error}");
    }
}

#[test]
fn the_help_says_how_to_give_a_loop_its_bound() {
    let (_, help, _) = sim(&["bounds", "--help"]);
    for part in ["stack at its deepest: ", "is refused", "[[loop]]", "at_most = "] {
        assert!(help.contains(part), "{part}: {help}");
    }
}

#[test]
fn what_is_no_program_is_refused() {
    let (code, _, error) = sim(&["bounds", env!("CARGO_MANIFEST_PATH")]);
    assert!(code == Some(3) && error.contains("not an ELF"), "{error}");
}
