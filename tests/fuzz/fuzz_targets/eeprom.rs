//! Fuzzes the EEPROM and its saves: `fuzz_harness::eeprom`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| fuzz_harness::eeprom::run(input));
