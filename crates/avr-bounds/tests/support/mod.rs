//! Programs for tests: assembled from text, or compiled from C, by avr-gcc.

#![allow(dead_code, reason = "each test file uses a part")]

use std::fs;
use std::path::PathBuf;
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use avr_bounds::annotations::Annotations;
use avr_bounds::chip::Chip;
use avr_bounds::program::Program;
use avr_bounds::stack::Analysis;
use avr_bounds::whole::{self, Stack};

/// Vectors of which INT0's leads to `int0`, INT1's to `int1` if the program has it, and the others
/// to the start of the program.
const VECTORS: &str = "
    .global start, int0
    .weak int1
    .section .text
    __vectors:
    jmp start
    jmp int0
    jmp int1
    .rept 23
    jmp start
    .endr
";

/// The start of a program, which sets SP to the end of the RAM, as avr-libc does.
pub const SET_SP: &str = "
    .type start, @function
    start:
    eor r1, r1
    ldi r28, 0xFF
    ldi r29, 0x04
    out 0x3E, r29
    out 0x3D, r28
";

/// A handler that does nothing.
pub const NO_HANDLER: &str = "
    .type int0, @function
    int0: reti
";

/// Builds a program by avr-gcc from a source with this ending.
pub fn build(name: &str, ending: &str, text: &str, options: &[&str]) -> PathBuf {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let unique = format!("bounds-{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
    let directory = std::env::temp_dir().join(unique);
    fs::create_dir_all(&directory).unwrap();
    let (source, elf) = (directory.join(format!("{name}.{ending}")), directory.join("program.elf"));
    fs::write(&source, text).unwrap();
    let output = Command::new("avr-gcc")
        .args(["-mmcu=atmega168", "-o"])
        .arg(&elf)
        .args(options)
        .arg(&source)
        .output()
        .expect("avr-gcc");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    elf
}

/// Assembles a program with a table of vectors.
pub fn assembled(name: &str, text: &str) -> Program {
    let elf = build(name, "S", &format!("{VECTORS}\n{text}"), &["-nostartfiles", "-nostdlib"]);
    read(&elf)
}

/// Compiles a program with avr-libc.
pub fn compiled(name: &str, text: &str, optimisation: &str) -> Program {
    read(&build(name, "c", text, &[optimisation, "-std=gnu99"]))
}

/// Reads an ELF for an ATmega168, and removes it.
pub fn read(elf: &PathBuf) -> Program {
    let program = Program::from_elf(&fs::read(elf).unwrap(), Chip::Atmega168).unwrap();
    fs::remove_dir_all(elf.parent().unwrap()).unwrap();
    program
}

/// The stack of a program without annotations.
pub fn stack(program: &Program) -> anyhow::Result<Stack> {
    stack_with(program, "")
}

/// The stack of a program with annotations.
pub fn stack_with(program: &Program, annotations: &str) -> anyhow::Result<Stack> {
    let annotations = Annotations::parse(annotations)?;
    whole::stack(&mut Analysis::new(program, &annotations))
}

/// The text of the error with its causes.
#[track_caller]
pub fn refusal<T>(result: anyhow::Result<T>) -> String {
    match result {
        Ok(_) => panic!("the program was accepted"),
        Err(error) => format!("{error:#}"),
    }
}
