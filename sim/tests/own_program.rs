//! Somebody else's program in the program `sim`: the recipe "Run your own firmware" of docs/bench.md.

mod links;

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use links::{Scratch, elf, elf_for};

/// The options of docs/bench.md for an Uno with a blue module.
const UNO: [&str; 8] = ["--mcu", "atmega328p", "--cs", "D10", "--int", "D2", "--crystal", "8"];

fn sim(elf: &Path, options: &[&str]) -> Output {
    sim_for("1s", elf, options)
}

fn sim_for(duration: &str, elf: &Path, options: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sim"))
        .args(["--plain", "--speed", "max", "--no-autopilot", "--for", duration, "--elf"])
        .arg(elf)
        .args(options)
        .output()
        .expect("sim starts")
}

#[track_caller]
fn lines(output: &Output) -> String {
    let (out, error) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{out}\n{error}");
    out.into_owned()
}

#[track_caller]
fn refused(output: &Output) -> String {
    assert!(!output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A line of candump: time in seconds, and the frame.
fn frame(line: &str) -> (f64, &str) {
    let (time, rest) = line.strip_prefix('(').and_then(|rest| rest.split_once(") can0 ")).expect("a line of candump");
    (time.parse().expect("seconds"), rest)
}

#[test]
fn a_program_for_the_uno_with_a_blue_module_sends_its_frames() {
    let scratch = Scratch::new();
    let (program, log) = (elf_for(&scratch, "uno", "atmega328p"), scratch.path("frames.log"));
    let log_option = ["--log", log.to_str().unwrap()];
    for options in [&UNO[..], &UNO[2..], &["--board", "uno", "--shield", "module"]] {
        let said = lines(&sim(&program, &[options, &log_option].concat()));
        let text = fs::read_to_string(&log).unwrap();
        let frames: Vec<(f64, &str)> = text.lines().map(frame).collect();
        assert_eq!(frames.len(), 10, "{text}");
        for ((_, frame), count) in frames.iter().zip(0..) {
            assert_eq!(*frame, format!("123#A5{count:02X}"));
        }
        for pair in frames.windows(2) {
            assert!((0.0995..0.1005).contains(&(pair[1].0 - pair[0].0)), "{text}");
        }
        let (first, rest) = said.split_once('\n').unwrap();
        assert!(first.contains(" board   Arduino") && first.contains("(ATmega328P)"), "{first}");
        assert!(first.contains("CS D10, INT D2, crystal 8 MHz") && first.ends_with("bus 500 kbit/s"), "{first}");
        assert!(rest.contains("serial  CAN started"), "{rest}");
        // Limits and stack are for programs that know of them.
        assert!(rest.contains("\nbus             10 frames, 0 error frames, 0 not acknowledged\n"), "{rest}");
        let figure =
            |name: &str| rest.lines().find(|line| line.starts_with(name)).map(|line| line.split_whitespace().count());
        assert_eq!([figure("flash"), figure("statics"), figure("stack")], [Some(3), Some(3), None], "{rest}");
    }
}

#[test]
fn what_the_board_cannot_do_is_refused_with_the_reason() {
    let scratch = Scratch::new();
    let program = elf_for(&scratch, "uno", "atmega328p");
    let error = refused(&sim(&program, &[&UNO[..], &["--bit-rate", "1000000"]].concat()));
    assert!(error.contains("a crystal of 8 MHz does at most 500000 bit/s"), "{error}");
    let error = refused(&sim(&program, &["--board", "mega"]));
    assert!(error.contains("no board is called \"mega\": use diecimila, "), "{error}");
    let error = refused(&sim(&program, &["--shield", "mega"]));
    assert!(error.contains("no CAN board is called \"mega\": use module, "), "{error}");
    let error = refused(&sim(&program, &["--mcu", "mega"]));
    assert!(error.contains("use atmega168 or atmega328p"), "{error}");
    let error = refused(&sim(&program, &["--cs", "D13"]));
    assert!(error.contains("CS is on D13, which is SCK's"), "{error}");
}

/// The stack begins where the smaller chip has no RAM.
#[test]
fn a_program_for_a_larger_chip_makes_mistakes_that_are_counted() {
    let scratch = Scratch::new();
    let output = sim_for("100ms", &elf_for(&scratch, "uno", "atmega328p"), &["--mcu", "atmega168"]);
    assert!(refused(&output).contains("mistakes"));
    let said = String::from_utf8_lossy(&output.stdout);
    let expected = "MISTAKE AVR: the program writes 0x08ff, and the RAM of an ATmega168 ends at 0x04ff";
    assert!(said.contains(expected), "{said}");
}

#[test]
fn a_program_without_a_word_about_its_board_runs_on_the_default_one() {
    let scratch = Scratch::new();
    let said = lines(&sim(&elf(&scratch, "echo"), &[]));
    let first = said.lines().next().unwrap();
    assert!(first.contains("Arduino Diecimila (ATmega168), Seeed CAN-BUS shield"), "{first}");
    assert!(first.ends_with("bus 1000 kbit/s"), "{first}");
}
