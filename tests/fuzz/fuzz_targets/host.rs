//! Fuzzes the parsers of host programs: `fuzz_harness::host`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| fuzz_harness::host::run(input));
