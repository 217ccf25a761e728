//! Compiles a small program in C and loads it.

#![allow(dead_code, reason = "each test file uses some of these")]

use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use anyhow::Result;
use bench::F_CPU_HZ;
use bench::avr::{Avr, Chip, Engine, Firmware, ResetCause, Violation};

/// The engine of all tests of a test program: `avr_on_own_core` has the tests of the others again.
pub const ENGINE: Engine = match env!("CARGO_CRATE_NAME").as_bytes() {
    b"avr_on_own_core" => Engine::Own,
    _ => Engine::Simavr,
};

/// CPU cycles of a millisecond.
pub const MS: u64 = F_CPU_HZ / 1000;
/// CPU cycles of a microsecond.
pub const US: u64 = F_CPU_HZ / 1_000_000;

/// Compiles `tests/avr/<name>.c` with macros defined. Returns an ATmega168 with the program, just
/// powered on.
#[track_caller]
pub fn program(name: &str, defines: &[&str]) -> Avr {
    program_for(Chip::Atmega168, name, defines)
}

/// Compiles `tests/avr/<name>.c` with macros defined. Returns a chip with the program, just powered
/// on.
#[track_caller]
pub fn program_for(chip: Chip, name: &str, defines: &[&str]) -> Avr {
    with_firmware(&firmware_for(chip, name, defines)).expect("a program that fits")
}

/// A chip with a program, just powered on.
pub fn with_firmware(firmware: &Firmware) -> Result<Avr> {
    Avr::programmed_on(ENGINE, firmware.chip()?.unwrap_or_default(), firmware)
}

/// A chip with erased flash, just powered on.
pub fn blank(chip: Chip) -> Avr {
    Avr::blank_on(ENGINE, chip).expect("a chip")
}

/// Compiles `tests/avr/<name>.c` as a bootloader at byte address `start`. Returns a chip with the
/// program, just powered on.
#[track_caller]
pub fn bootloader_for(chip: Chip, start: usize, name: &str, defines: &[&str]) -> Avr {
    let section = format!("-Wl,--section-start=.text={start:#x}");
    let firmware = compile(chip, name, defines, &[&section]).expect("an ELF file");
    assert_eq!(firmware.boot_section(chip).expect("a bootloader"), start);
    let mut avr = Avr::programmed_on(ENGINE, chip, &firmware).expect("a program that fits");
    avr.set_reset_vector(start as u32);
    avr.reset(ResetCause::PowerOn);
    avr
}

/// Compiles `tests/avr/<name>.c` for a chip.
#[track_caller]
pub fn firmware_for(chip: Chip, name: &str, defines: &[&str]) -> Firmware {
    read(chip, name, defines).expect("an ELF file")
}

/// Compiles `tests/avr/<name>.c` for a chip, and reads the ELF file, which can fail.
#[track_caller]
pub fn read(chip: Chip, name: &str, defines: &[&str]) -> Result<Firmware> {
    compile(chip, name, defines, &[])
}

#[track_caller]
fn compile(chip: Chip, name: &str, defines: &[&str], options: &[&str]) -> Result<Firmware> {
    built(|elf| compile_to(elf, chip.name(), name, defines, options))
}

/// Compiles `tests/avr/<name>.c` for a chip to a file, with macros defined.
#[track_caller]
pub fn compile_to(elf: &Path, chip: &str, name: &str, defines: &[&str], options: &[&str]) {
    let mut line = Command::new("avr-gcc");
    line.arg(format!("-mmcu={chip}"))
        .args(["-DF_CPU=16000000UL", "-Os", "-Wall", "-Wextra", "-Werror", "-std=gnu11"])
        .args(defines.iter().map(|define| format!("-D{define}")))
        .args(options)
        .arg(bench::root().join(format!("sim/bench/tests/avr/{name}.c")));
    run(line, elf);
}

/// Compiles `tests/avr/<name>.cpp` with Arduino's core and its library Wire. Returns an Uno with
/// it, just powered on.
#[track_caller]
pub fn sketch(name: &str) -> Avr {
    let firmware = built(|elf| sketch_to(elf, name, &[])).expect("an ELF file");
    Avr::with_firmware(&firmware).expect("a program that fits")
}

/// The same to a file, with macros defined.
#[track_caller]
pub fn sketch_to(elf: &Path, name: &str, defines: &[&str]) {
    let arduino = Path::new("/usr/share/arduino/hardware/arduino/avr");
    assert!(arduino.exists(), "arduino-core-avr is missing: \"make test\" installs it");
    let folders = ["cores/arduino", "variants/standard", "libraries/Wire/src"];
    let core = "main.cpp hooks.c wiring.c wiring_digital.c Print.cpp Stream.cpp abi.cpp \
                HardwareSerial.cpp HardwareSerial0.cpp";
    let options = "-mmcu=atmega328p -std=gnu++11 -DF_CPU=16000000UL -DARDUINO=10819 -Os -w \
                   -fpermissive -ffunction-sections -fdata-sections -Wl,--gc-sections";
    let mut line = Command::new("avr-gcc");
    line.args(options.split_whitespace())
        .args(folders.map(|folder| format!("-I{}", arduino.join(folder).display())))
        .args(defines.iter().map(|define| format!("-D{define}")))
        .arg(bench::root().join(format!("sim/bench/tests/avr/{name}.cpp")))
        .args(core.split_whitespace().map(|file| arduino.join(folders[0]).join(file)))
        .args(["Wire.cpp", "utility/twi.c"].map(|file| arduino.join(folders[2]).join(file)));
    run(line, elf);
}

#[track_caller]
fn run(mut line: Command, elf: &Path) {
    let compiled = line.arg("-o").arg(elf).status();
    let compiled = compiled.unwrap_or_else(|error| panic!("avr-gcc: {error}: make test"));
    assert!(compiled.success(), "{line:?} fails");
}

/// Reads what `make` puts into a temporary file.
#[track_caller]
fn built(make: impl FnOnce(&Path)) -> Result<Firmware> {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let unique = format!("sim-avr-{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
    let elf = std::env::temp_dir().join(unique);
    make(&elf);
    let firmware = Firmware::read(&elf);
    std::fs::remove_file(&elf).expect("the temporary file removed");
    firmware
}

/// Address of a variable in the data space.
#[track_caller]
pub fn address(avr: &Avr, name: &str) -> u16 {
    avr.symbol(name).unwrap_or_else(|| panic!("no variable {name}")).address as u16
}

/// Value of a variable of one byte.
#[track_caller]
pub fn byte(avr: &Avr, name: &str) -> u8 {
    avr.sram(address(avr, name))
}

/// Value of a variable of two bytes.
#[track_caller]
pub fn word(avr: &Avr, name: &str) -> u16 {
    let low = address(avr, name);
    u16::from_le_bytes([avr.sram(low), avr.sram(low + 1)])
}

/// Value of an array of bytes.
#[track_caller]
pub fn bytes(avr: &Avr, name: &str) -> Vec<u8> {
    let symbol = avr.symbol(name).unwrap_or_else(|| panic!("no variable {name}"));
    let first = symbol.address as u16;
    avr.sram_range(first..=first + symbol.size as u16 - 1)
}

/// Fails if the program has made a mistake.
#[track_caller]
pub fn assert_no_violation(avr: &mut Avr) {
    assert_eq!(avr.take_violations(), []);
}

/// Fails unless the program has made exactly one mistake, whose text contains `text`.
#[track_caller]
pub fn assert_one_violation(avr: &mut Avr, text: &str) {
    let violations: Vec<Violation> = avr.take_violations();
    assert!(violations.len() == 1 && violations[0].text.contains(text), "{violations:?}");
}
