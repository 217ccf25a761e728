//! Runs every input of `fuzz/corpus` without the fuzzer, so that old findings stay repaired and the corpus fits the harness.

use std::fs;
use std::path::Path;

/// Runs the corpus of a target; returns the number of inputs.
fn run(target: &str, run: fn(&[u8])) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../corpus").join(target);
    let mut paths: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(paths.len() >= 5, "no corpus in {}", folder.display());
    for path in paths {
        let input = fs::read(&path).unwrap();
        let outcome = std::panic::catch_unwind(|| run(&input));
        assert!(outcome.is_ok(), "{}", path.display());
    }
}

#[test]
fn the_node_holds_out_against_its_corpus() {
    run("node", fuzz_harness::node::run);
}

#[test]
fn any_eeprom_of_the_corpus_is_started_with_and_saved_to() {
    run("eeprom", fuzz_harness::eeprom::run);
}

#[test]
fn host_programs_read_their_corpus() {
    run("host", fuzz_harness::host::run);
}

#[test]
fn the_simulator_reads_its_corpus() {
    run("sim", fuzz_harness::sim::run);
}

#[test]
fn the_bridge_holds_out_against_its_corpus() {
    run("bridge", fuzz_harness::bridge::run);
}
