//! Fuzzes the commanders of eight outputs: `fuzz_harness::commanders`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| fuzz_harness::commanders::run(input));
