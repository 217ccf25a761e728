//! Fuzzes the firmware's library: `fuzz_harness::node`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| fuzz_harness::node::run(input));
