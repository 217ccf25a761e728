//! Runs every input of `tests/fuzz/corpus` without the fuzzer, so that fixed defects do not return
//! and the corpus fits the harness.

use std::fs;
use std::path::Path;

/// Runs the corpus of a target. Fails if it has fewer than five inputs.
fn run(target: &str, run: fn(&[u8])) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../corpus").join(target);
    let mut paths: Vec<_> =
        fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(paths.len() >= 5, "no corpus in {}", folder.display());
    for path in paths {
        let input = fs::read(&path).unwrap();
        let outcome = std::panic::catch_unwind(|| run(&input));
        assert!(outcome.is_ok(), "{}", path.display());
    }
}

#[test]
fn no_input_of_the_corpus_fails_in_the_node() {
    run("node", crate::node::run);
}

#[test]
fn no_input_of_the_corpus_fails_with_three_commanders() {
    run("commanders", crate::commanders::run);
}

#[test]
fn no_input_of_the_corpus_fails_as_an_eeprom() {
    run("eeprom", crate::eeprom::run);
}

#[test]
fn no_input_of_the_corpus_fails_in_the_host_parsers() {
    run("host", crate::host::run);
}

#[test]
fn no_input_of_the_corpus_fails_in_the_simulator() {
    run("sim", crate::sim::run);
}

#[test]
fn no_input_of_the_corpus_fails_in_the_bridge() {
    run("bridge", crate::bridge::run);
}
