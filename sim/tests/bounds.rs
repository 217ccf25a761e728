//! Tests of `sim bounds`.

use std::path::Path;
use std::process::Command;

use bench::{node_elf, root};

/// The exit code, the output, and the text on the error output.
fn bounds(elf: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_sim"))
        .arg("bounds")
        .arg(elf)
        .args(arguments)
        .output()
        .expect("sim starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

#[test]
fn the_stack_and_the_handlers_of_the_node_are_printed() {
    let annotations = root().join("avr-specs/bounds.toml");
    let annotations = annotations.to_str().expect("text");
    let (code, text, error) =
        bounds(&node_elf().expect("a firmware"), &["--annotations", annotations]);
    assert_eq!(code, Some(0), "{error}");
    for part in ["stack at its deepest: ", " + INT0 ", "handler of INT0: ", "INT0 blocked for "] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn a_handler_with_a_loop_without_a_bound_is_refused_with_the_place() {
    let (code, _, error) = bounds(&node_elf().expect("a firmware"), &[]);
    assert_eq!(code, Some(3));
    assert!(error.contains("in fetch: loop 1 has no bound"), "{error}");
}

#[test]
fn the_help_and_the_refusal_say_how_to_give_a_loop_its_bound() {
    let output = Command::new(env!("CARGO_BIN_EXE_sim"))
        .args(["bounds", "--help"])
        .output()
        .expect("sim starts");
    let help = String::from_utf8_lossy(&output.stdout).into_owned();
    for part in ["stack at its deepest: ", "is refused", "[[loop]]", "at_most = "] {
        assert!(help.contains(part), "{part}: {help}");
    }
    let (_, _, error) = bounds(&node_elf().expect("a firmware"), &[]);
    assert!(error.contains("[[loop]]") && error.contains("--annotations"), "{error}");
}

#[test]
fn what_is_no_program_is_refused() {
    let (code, _, error) = bounds(Path::new(env!("CARGO_MANIFEST_PATH")), &[]);
    assert!(code == Some(3) && error.contains("not an ELF"), "{error}");
}
