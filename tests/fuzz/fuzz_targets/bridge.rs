//! Fuzzes the MAVLink bridge: `fuzz_harness::bridge`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| fuzz_harness::bridge::run(input));
