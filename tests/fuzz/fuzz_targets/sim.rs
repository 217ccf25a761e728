//! Fuzzes the simulator's inputs: `fuzz_harness::sim`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| fuzz_harness::sim::run(input));
