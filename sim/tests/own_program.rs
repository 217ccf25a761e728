//! Tests of `sim` with programs of other projects: the recipe "Run your own firmware" of
//! docs/sketch.md.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use bench::node_elf;

use crate::avr::sketch_to;
use crate::links::{Scratch, elf, elf_for, elf_with};
use rustix::process::{Pid, Signal, WaitOptions, kill_process, waitpid};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{LocalModes, Winsize, tcgetattr, tcsetwinsize};
use serde_json::{Value, json};

/// The options of docs/sketch.md for an Uno with a blue module.
const UNO: [&str; 8] = ["--mcu", "atmega328p", "--cs", "D10", "--int", "D2", "--crystal", "8"];

fn sim(elf: &Path, options: &[&str]) -> Output {
    sim_for("1s", elf, options)
}

fn sim_for(duration: &str, elf: &Path, options: &[&str]) -> Output {
    beside_autopilot(duration, elf, &[&["--no-autopilot"], options].concat())
}

fn beside_autopilot(duration: &str, elf: &Path, options: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sim"))
        .args(["--plain", "--speed", "max", "--for", duration, "--elf"])
        .arg(elf)
        .args(options)
        .output()
        .expect("sim starts")
}

/// The output of a run, its report, and its exit code.
#[track_caller]
fn result(program: &Path, options: &[&str]) -> (String, Value, Option<i32>) {
    let path = program.with_extension("json");
    let output = sim(program, &[options, &["--json", path.to_str().unwrap()]].concat());
    let report = fs::read_to_string(&path).expect("a report");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    (text, serde_json::from_str(&report).expect("JSON"), output.status.code())
}

/// The same of the program `uno.c` with macros defined.
#[track_caller]
fn uno(defines: &[&str], options: &[&str]) -> (String, Value, Option<i32>) {
    let scratch = Scratch::new();
    result(&elf_with(&scratch, "uno", "atmega328p", defines), options)
}

#[track_caller]
fn lines(output: &Output) -> String {
    let (out, error) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{out}\n{error}");
    out.into_owned()
}

#[track_caller]
fn error_text(output: &Output) -> String {
    assert!(!output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A line of candump: time in seconds, and the frame.
fn frame(line: &str) -> (f64, &str) {
    let (time, rest) = line
        .strip_prefix('(')
        .and_then(|rest| rest.split_once(") can0 "))
        .expect("a line of candump");
    (time.parse().expect("seconds"), rest)
}

#[test]
fn a_program_for_the_uno_with_a_blue_module_sends_its_frames() {
    let scratch = Scratch::new();
    let (program, log) = (elf_for(&scratch, "uno", "atmega328p"), scratch.path("frames.log"));
    let log_option = ["--log", log.to_str().unwrap()];
    for options in [&UNO[..], &UNO[2..], &["--board", "uno", "--shield", "module"]] {
        let output = lines(&sim(&program, &[options, &log_option].concat()));
        let text = fs::read_to_string(&log).unwrap();
        let frames: Vec<(f64, &str)> = text.lines().map(frame).collect();
        assert_eq!(frames.len(), 10, "{text}");
        for ((_, frame), count) in frames.iter().zip(0..) {
            assert_eq!(*frame, format!("123#A5{count:02X}"));
        }
        for pair in frames.windows(2) {
            assert!((0.0995..0.1005).contains(&(pair[1].0 - pair[0].0)), "{text}");
        }
        let (first, rest) = output.split_once('\n').unwrap();
        assert!(first.contains(" board   Arduino") && first.contains("(ATmega328P)"), "{first}");
        assert!(
            first.contains("CS D10, INT D2, crystal 8 MHz") && first.ends_with("bus 500 kbit/s"),
            "{first}"
        );
        assert!(rest.contains("serial  CAN started"), "{rest}");
        // Only programs of this project have limits of their own.
        assert!(
            rest.contains("\nbus             10 frames, 0 error frames, 0 not acknowledged\n"),
            "{rest}"
        );
        for (name, words) in [("flash", 3), ("statics", 3), ("stack", 14)] {
            let line = rest.lines().find(|line| line.starts_with(name)).expect(name);
            assert_eq!(line.split_whitespace().count(), words, "{line}");
        }
    }
}

#[test]
fn the_error_of_an_option_that_the_board_cannot_fulfil_has_the_reason() {
    let scratch = Scratch::new();
    let program = elf_for(&scratch, "uno", "atmega328p");
    let pins = |option| [&UNO[..], &[option]].concat();
    for (options, expected) in [
        (vec!["--board", "mega"], "no board is called \"mega\": use diecimila, "),
        (vec!["--shield", "mega"], "no CAN board is called \"mega\": use module, "),
        (vec!["--mcu", "mega"], "use atmega168 or atmega328p"),
        (vec!["--cs", "D13"], "CS is on D13, which is SCK's"),
        (pins("--set=D7=2.5V"), "D7 is digital"),
        (pins("--set=A1=7V"), "a voltage from 0V to 5V"),
        (pins("--set=D10=low"), "D10 is CS of the MCP2515"),
        (pins("--watch=D14"), "use D0 to D13 or A0 to A5"),
        (pins("--vcd-signals=MISO,BUS"), "no signal is called \"BUS\": use CAN, "),
        (pins("--json=/nowhere/x"), "--json: cannot write /nowhere/x"),
        (pins("--inject=cable@2s"), "cable@2s: the run ends before, at 1 s (--for)"),
    ] {
        let output = sim(&program, &options);
        let error = error_text(&output);
        assert!(error.contains(expected), "{options:?}: {error}");
        assert!(output.stdout.is_empty(), "{options:?}: a run before the error");
    }
    let error = error_text(&sim(Path::new("/dev/zero"), &[]));
    assert!(error.contains("cannot read /dev/zero: it has more than"), "{error}");
}

/// The program's stack begins beyond the RAM of the smaller chip.
#[test]
fn a_program_for_a_larger_chip_makes_mistakes_that_are_printed_once_and_counted() {
    let (text, report, code) = uno(&[], &["--mcu", "atmega168"]);
    let expected =
        "MISTAKE AVR: the program writes 0x08ff, but the RAM of an ATmega168 ends at 0x04ff";
    assert!(text.contains(expected), "{text}");
    let hint = "HINT    the program is for an ATmega328P, the board has an ATmega168";
    assert!(text.contains(hint), "{text}");
    assert_eq!((code, &report["outcome"]), (Some(1), &json!("mistakes")));
    assert_eq!(report["exit_code"], 1);
    let kinds = report["mistakes"].as_array().unwrap();
    assert_eq!(text.matches(" MISTAKE ").count(), kinds.len(), "{text}");
    assert_eq!(text.matches("\nmistake  ").count(), kinds.len(), "{text}");
    let total: u64 = kinds.iter().map(|kind| kind["count"].as_u64().unwrap()).sum();
    assert_eq!(report["mistakes_total"], total);
}

/// No hint is a failure, and each is in the report.
#[test]
fn programs_that_do_not_fit_their_settings_get_a_hint_once_and_others_none() {
    let with = |options: &[&'static str]| [&UNO[..], options].concat();
    let d3 = vec!["--mcu", "atmega328p", "--cs", "D10", "--int", "D3", "--crystal", "8"];
    let other_rate = "HINT    the node is at 500 kbit/s, the bus at 250 kbit/s";
    let waits =
        |mode| format!("HINT    a frame waits to be sent, but the MCP2515 is in {mode} mode");
    let int = "HINT    INT of the MCP2515 (D2) is low, but the program has never looked at that \
               pin, only at D3";
    let baud = "HINT    the UART is at 13888 baud, which no serial monitor has";
    for (define, options, hint) in [
        (None, with(&[]), None),
        (None, with(&["--bit-rate", "250000"]), Some(other_rate)),
        (Some("UBRR=103"), with(&[]), None),
        (Some("UBRR=71"), with(&[]), Some(baud)),
        // Another device on the SPI with its own chip select.
        (Some("SD_CARD"), with(&[]), None),
        (Some("MODE=0x80"), with(&[]), Some(&waits("configuration")[..])),
        (Some("MODE=0x60"), with(&[]), Some(&waits("listen-only")[..])),
        // Without an interrupt a program can ask the controller over the SPI.
        (Some("INT_ON_D3"), with(&[]), Some(int)),
        (Some("INT_ON_D3"), d3, None),
    ] {
        let (text, report, code) = uno(define.as_slice(), &options);
        let case = format!("{define:?} {options:?}: {text}");
        assert_eq!((code, &report["outcome"]), (Some(0), &json!("well")), "{case}");
        assert!(!text.contains("MISTAKE"), "{case}");
        assert_eq!(text.matches("HINT").count(), usize::from(hint.is_some()), "{case}");
        let hints = report["hints"].as_array().unwrap();
        match hint {
            Some(hint) => {
                assert!(text.contains(hint), "{case}");
                assert!(hints[0].as_str().unwrap().starts_with(&hint[8..]), "{report}");
            }
            None => assert_eq!(hints.len(), 0, "{report}"),
        }
        let elsewhere = if define == Some("SD_CARD") { 60 } else { 0 };
        assert_eq!(report["spi"]["bytes_elsewhere"], elsewhere, "{case}");
        let notes = text.matches("board   the serial port has 9600 baud").count();
        assert_eq!(notes, usize::from(define == Some("UBRR=103")), "{case}");
    }
}

#[test]
fn there_is_a_hint_for_a_chip_select_on_another_pin() {
    let (text, ..) = uno(&[], &["--mcu", "atmega328p", "--cs", "D9", "--crystal", "8"]);
    assert!(text.contains("but CS of the MCP2515 (D9) has never been low"), "{text}");
    let named = text.find("the program drives D10, CS is wired to D9 (--cs D10)");
    let named = named.unwrap_or_else(|| panic!("{text}"));
    assert!(text.find("MISTAKE").is_none_or(|mistake| named < mistake), "{text}");
    // On a board whose servo would be at D10, where the sketch has CS.
    let (text, report, _) = uno(&[], &["--mcu", "atmega328p", "--crystal", "8"]);
    assert!(text.contains("the program drives D10, CS is wired to D9 (--cs D10)"), "{text}");
    assert!(!text.contains("motor") && !text.contains("servo   pulse"), "{text}");
    assert_eq!(report["servo"]["pulses"], 0);
}

#[test]
fn the_result_has_frames_spi_bytes_and_memory() {
    let (text, report, code) = uno(&[], &UNO);
    assert_eq!(code, Some(0));
    for (place, value) in [
        ("/exit_code", json!(0)),
        ("/simulated_s", json!(1.0)),
        ("/node/frames_sent", json!(10)),
        ("/node/frames_received", json!(0)),
        ("/bus/frames", json!(10)),
        ("/bus/bit_rate", json!(500_000)),
    ] {
        assert_eq!(report.pointer(place), Some(&value), "{place}");
    }
    // A frame takes 12 bytes: READ of TXB0CTRL, LOAD TX BUFFER with 8, RTS. The rest is the
    // configuration of the MCP2515.
    let bytes = report["spi"]["bytes_per_frame"].as_f64().unwrap();
    assert!((12.0..16.0).contains(&bytes), "{bytes}");
    let spi = text.lines().find(|line| line.starts_with("SPI")).expect("a line");
    assert!(spi.contains("bytes in"), "{spi}");
    assert!(spi.ends_with("for 0 frames received and 10 sent"), "{spi}");
}

#[test]
fn the_exit_code_is_2_for_a_wrong_command_line_and_3_for_an_error_of_the_computer() {
    let scratch = Scratch::new();
    let program = elf_for(&scratch, "uno", "atmega328p");
    let text = scratch.path("text");
    fs::write(&text, "this is no ELF file").unwrap();
    let text = text.to_str().unwrap();
    let code = |options: &[&str]| sim(&program, options).status.code();
    for usage in [
        &["--bit-rate", "1000001"][..],
        &["--cs", "D13"],
        &["--nodes", "127"],
        &["--for", "x"],
        &["--eeprom", text],
        &["--script", text],
        &["--eeprom", "/dev/zero"],
    ] {
        assert_eq!(code(usage), Some(2), "{usage:?}");
    }
    for machine in [
        &["--script", "/nowhere/script"][..],
        &["--slcan", "/nowhere/can"],
        &["--log", "/nowhere/log"],
    ] {
        assert_eq!(code(machine), Some(3), "{machine:?}");
    }
    let elf = |path: &Path| sim(path, &[]).status.code();
    assert_eq!((elf(Path::new("/nowhere/elf")), elf(Path::new(text))), (Some(3), Some(2)));
}

/// A build that sends nothing must not pass.
#[test]
fn a_strict_run_fails_for_a_program_that_does_not_work() {
    let scratch = Scratch::new();
    let uno = || elf_for(&scratch, "uno", "atmega328p");
    let strict = |program: &Path, options: &[&str], code, outcome: &str, findings: &[&str]| {
        let (text, report, found) = result(program, &[options, &["--strict"]].concat());
        assert_eq!((found, &report["outcome"]), (Some(code), &json!(outcome)), "{text}");
        assert_eq!((&report["exit_code"], &report["findings"]), (&json!(code), &json!(findings)));
    };
    strict(&uno(), &UNO, 0, "well", &[]);
    // Correct programs: a slow serial port; one that only receives; one with what is not modelled.
    let built = |defines: &[&str]| elf_with(&scratch, "uno", "atmega328p", defines);
    strict(&built(&["UBRR=103"]), &UNO, 0, "well", &[]);
    let listener = built(&["LISTENER"]);
    strict(&listener, &UNO, 1, "never_sent", &["never_sent"]);
    lines(&beside_autopilot("1s", &listener, &[&UNO[..], &["--strict"]].concat()));
    let allowed = [&UNO[..], &["--allow", "never_sent,hints"]].concat();
    strict(&listener, &allowed, 0, "well", &["never_sent"]);
    // The wrong crystal.
    let wrong = ["--mcu", "atmega328p", "--cs", "D10", "--int", "D2", "--crystal", "16"];
    let wrong = [&wrong[..], &["--bit-rate", "500000"]].concat();
    strict(&uno(), &wrong, 1, "never_sent", &["never_sent", "hints"]);
    // Programs that leave the SPI alone have no CAN.
    strict(&elf(&scratch, "spin"), &[], 0, "well", &[]);
    strict(&elf(&scratch, "watchdog"), &[], 1, "restarted", &["restarted"]);
    let jump = elf_with(&scratch, "features", "atmega168", &["FEATURE=DDRB=1", "JUMP"]);
    strict(&jump, &[], 1, "restarted", &["restarted"]);
    let without = sim(&jump, &[]);
    assert_eq!(without.status.code(), Some(0));
    let text = String::from_utf8_lossy(&without.stdout).into_owned();
    assert!(text.contains("the program jumped to its start without a reset"), "{text}");
}

#[test]
fn what_is_not_modelled_is_reported_with_the_exit_code_of_the_option() {
    let scratch = Scratch::new();
    let program = elf_with(&scratch, "features", "atmega168", &["FEATURE=TWAR=0x20,CLKPR=0"]);
    for (options, expected) in
        [(&[][..], 0), (&["--unmodelled-exit", "4"], 4), (&["--unmodelled-exit", "0"], 0)]
    {
        let (text, result, code) = result(&program, options);
        assert_eq!(code, Some(expected), "{text}");
        assert_eq!(text.matches("HINT    not modelled exactly: the TWI").count(), 1, "{text}");
        assert_eq!(result["unmodelled"].as_array().unwrap().len(), 1, "{result}");
        let outcome = if expected == 0 { "well" } else { "unmodelled" };
        assert_eq!(result["outcome"], outcome);
    }
}

#[test]
fn a_stack_that_runs_into_variables_fails_the_run_and_is_named_as_the_cause() {
    let scratch = Scratch::new();
    let program = scratch.path("overrun.elf");
    let run = |depth: &str| {
        sketch_to(&program, "overrun", &[&format!("DEPTH={depth}")]);
        result(&program, &[])
    };
    let (text, report, code) = run("3");
    assert_eq!((code, &report["outcome"]), (Some(0), &"well".into()), "{text}");
    let stack = report["budget"]["stack"].as_u64().unwrap();
    assert!((800..950).contains(&stack), "{stack}");
    assert_eq!(report["budget"]["lowest_sp"], 0x8FF - stack);
    let (text, report, code) = run("8");
    assert_eq!((code, &report["outcome"]), (Some(1), &"mistakes".into()), "{text}");
    let stack = &report["budget"]["stack"];
    let expected = format!(": it is {stack} bytes deep in depth, and ");
    let line = text.lines().find(|line| line.contains("MISTAKE AVR: the stack runs into"));
    assert!(line.is_some_and(|line| line.contains(&expected)), "{text}");
    assert!(line.is_some_and(|line| line.contains("important")), "{text}");
    // Down to the registers: whatever the program does then has this cause.
    let (text, _, code) = run("100");
    assert_eq!(code, Some(1));
    let first = text.find("MISTAKE AVR: the stack runs into").unwrap();
    assert_eq!(text.find("MISTAKE"), Some(first), "the cause comes first: {text}");
    assert!(text[first..].contains("more: it is "), "{text}");
    let consequence = text.find(", after its stack had run into variables");
    assert!(consequence.is_some_and(|at| at > first), "{text}");
}

#[test]
fn a_device_that_is_missing_on_the_two_wire_bus_is_a_hint_and_one_that_is_there_is_seen() {
    let scratch = Scratch::new();
    let program = scratch.path("wire.elf");
    sketch_to(&program, "wire", &[]);
    let (text, report, _) = result(&program, &["--i2c", "0x48:0x00=0x19,0x80"]);
    let hint = "HINT    nobody acknowledges 0x49 on the two-wire bus: --i2c 0x49 puts a device";
    assert_eq!(text.matches(hint).count(), 1, "{text}");
    assert!(text.contains(" i2c     0x48 is written 00 gives 19 80\n"), "{text}");
    assert!(text.contains(" further transactions\n"), "{text}");
    assert_eq!(report["findings"], serde_json::json!(["hints"]));
    // `twi.c` writes two registers.
    let program = elf(&scratch, "twi");
    let (text, report, _) = result(&program, &["--i2c", "0x48"]);
    assert!(text.contains("\ni2c             0x48:0x10=0xA5,0x5A\n"), "{text}");
    let written = serde_json::json!([{"address": 0x48, "register": 0x10, "values": [0xA5, 0x5A]}]);
    assert_eq!(report["i2c"], written);
}

#[test]
fn a_lost_frame_is_shown_with_the_buffer_that_was_full() {
    let scratch = Scratch::new();
    let script = scratch.path("frames.txt");
    fs::write(&script, "(0.3) can0 100#01\n(0.31) can0 101#02\n(0.32) can0 102#03\n").unwrap();
    let options = [&UNO[..], &["--script", script.to_str().unwrap()]].concat();
    let run = |define: &str| uno(&[define], &options).0;
    let hint = "HINT    the program has never written the filters of RXB0";
    // Standard frames pass the filters of RXB1 only.
    let text = run("MASKS");
    let line = "LOST    frame lost, RXB1 was full, and no filter of RXB0, which was empty, passes \
                the frame: 101#02";
    assert!(text.contains(line) && text.matches(hint).count() == 1, "{text}");
    let text = run("RXB0=0x60");
    let line = "LOST    frame lost, RXB0 was full, and its bit BUKT lets nothing go on to RXB1, \
                which was empty: 101#02";
    assert!(text.contains(line) && !text.contains(hint), "{text}");
    let text = run("RXB0=0x64");
    let line = "LOST    frame lost, both receive buffers were full: 102#03";
    assert!(text.contains(line) && !text.contains("101#02\n"), "{text}");
}

#[test]
fn a_node_with_a_crystal_that_is_too_slow_for_the_bus_can_be_shown() {
    let scratch = Scratch::new();
    let script = scratch.path("frames.txt");
    fs::write(&script, "(0.1) can0 100#01\n").unwrap();
    let options = ["--bit-rate", "1000000", "--traffic", "--script", script.to_str().unwrap()];
    let (text, ..) = uno(&[], &[&UNO[..], &options].concat());
    let hint = "the bus at 1000 kbit/s: each gets only errors from the other. A crystal of 8 MHz \
                does at most 500 kbit/s";
    assert!(text.contains(hint), "{text}");
    let errors = text.lines().filter(|line| line.contains("error frame")).count();
    assert!((3..=8).contains(&errors), "three, and then their number: {text}");
}

#[test]
fn a_recording_of_some_signals_has_no_others() {
    let scratch = Scratch::new();
    let program = elf_for(&scratch, "uno", "atmega328p");
    let file = scratch.path("wires.vcd");
    let bytes = |signals: &[&str]| {
        let options = [&UNO[..], &["--vcd", file.to_str().unwrap()], signals].concat();
        lines(&sim(&program, &options));
        fs::read_to_string(&file).unwrap()
    };
    let (all, can) = (bytes(&[]), bytes(&["--vcd-signals", "can,INT"]));
    assert!(all.contains(" SCK ") && can.contains(" CAN ") && can.contains(" INT "));
    assert!(!can.contains(" SCK ") && can.len() < all.len() / 3, "{} {}", can.len(), all.len());
}

/// A pseudo-terminal of 100 by 30: the end of the test, and that of the program.
fn terminal() -> (File, File) {
    let terminal = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&terminal).and_then(|()| unlockpt(&terminal)).unwrap();
    let name = ptsname(&terminal, Vec::new()).unwrap();
    let slave = File::options().read(true).write(true).open(name.to_str().unwrap()).unwrap();
    let size = Winsize { ws_row: 30, ws_col: 100, ws_xpixel: 0, ws_ypixel: 0 };
    tcsetwinsize(&slave, size).unwrap();
    (File::from(terminal), slave)
}

/// `sim` without options on a terminal, with the variables of a usual one.
fn on_terminal(program: &Path, slave: File) -> Command {
    let mut sim = Command::new(env!("CARGO_BIN_EXE_sim"));
    sim.args(["--no-autopilot", "--elf"]).arg(program).args(UNO);
    sim.env("TERM", "xterm").env("LC_ALL", "C.UTF-8").env_remove("NO_COLOR");
    sim.stdin(slave.try_clone().unwrap()).stdout(slave.try_clone().unwrap()).stderr(slave);
    sim
}

/// Reads until the text of the terminal contains `part`.
fn read_until(terminal: &mut File, part: &str) -> String {
    let mut shown: Vec<u8> = Vec::new();
    while !String::from_utf8_lossy(&shown).contains(part) {
        let mut bytes = [0; 4096];
        let count = terminal.read(&mut bytes).unwrap();
        shown.extend(&bytes[..count]);
    }
    String::from_utf8_lossy(&shown).into_owned()
}

const ESCAPE: char = '\u{1b}';

#[test]
fn a_terminal_without_colours_or_utf8_gets_lines() {
    let scratch = Scratch::new();
    let program = elf_for(&scratch, "uno", "atmega328p");
    for (name, value) in [("TERM", "dumb"), ("NO_COLOR", "1"), ("LC_ALL", "C"), ("A", "b")] {
        let (mut terminal, slave) = terminal();
        let mut child = on_terminal(&program, slave).env(name, value).spawn().unwrap();
        let shown = read_until(&mut terminal, "MCP2515");
        assert_eq!(shown.contains(ESCAPE), name == "A", "{name}: {shown}");
        child.kill().unwrap();
        child.wait().unwrap();
    }
}

/// Ctrl-Z gives the terminal back, and after SIGCONT the whole picture is drawn again, each time.
#[test]
fn control_z_stops_the_live_view_and_a_continued_one_draws_again() {
    let scratch = Scratch::new();
    let program = elf_for(&scratch, "uno", "atmega328p");
    let (mut terminal, slave) = terminal();
    let modes = slave.try_clone().unwrap();
    let is_raw = || !tcgetattr(&modes).unwrap().local_modes.contains(LocalModes::ICANON);
    // A job of its own, as of a shell: the signal stops all processes of the job.
    let mut child = on_terminal(&program, slave).process_group(0).spawn().unwrap();
    let pid = Pid::from_child(&child);
    read_until(&mut terminal, "MCP2515");
    for _ in 0..2 {
        assert!(is_raw());
        terminal.write_all(b"\x1a").unwrap();
        let shown = read_until(&mut terminal, "\u{1b}[?1049l");
        assert!(shown.contains("\u{1b}[?25h"), "the cursor is visible");
        let (_, status) = waitpid(Some(pid), WaitOptions::UNTRACED).unwrap().unwrap();
        assert_eq!(status.stopping_signal(), Some(Signal::TSTP.as_raw()));
        assert!(!is_raw());
        kill_process(pid, Signal::CONT).unwrap();
        let shown = read_until(&mut terminal, "MCP2515");
        assert!(shown.contains("\u{1b}[?1049h"), "{shown}");
    }
    terminal.write_all(b"q").unwrap();
    read_until(&mut terminal, "simulated");
    assert!(child.wait().unwrap().success());
}

/// When its window is closed, a simulator must not run for ever, and leaves what `q` leaves.
#[test]
fn a_live_view_ends_when_its_terminal_is_closed() {
    let scratch = Scratch::new();
    let program = elf_for(&scratch, "uno", "atmega328p");
    let (port, report) = (scratch.path("port"), scratch.path("report.json"));
    for _ in 0..5 {
        let (mut terminal, slave) = terminal();
        let mut sim = on_terminal(&program, slave);
        let mut child = sim.arg("--slcan").arg(&port).arg("--json").arg(&report).spawn().unwrap();
        read_until(&mut terminal, "MCP2515");
        drop(terminal);
        let start = Instant::now();
        let status = loop {
            if let Some(status) = child.try_wait().unwrap() {
                break status;
            }
            if start.elapsed() > Duration::from_secs(60) {
                child.kill().unwrap();
                panic!("sim still runs");
            }
            std::thread::sleep(Duration::from_millis(10));
        };
        assert_eq!(status.code(), Some(0), "as after q");
        assert!(fs::symlink_metadata(&port).is_err(), "the link of the port is still there");
        assert!(fs::read_to_string(&report).unwrap().contains("exit_code"), "no report");
        fs::remove_file(&report).unwrap();
    }
}

/// The program of `own_pins.c`: a LED that follows a button, one that follows a voltage, a tone.
#[test]
fn the_pins_of_a_program_are_set_and_watched_by_options_and_by_a_script() {
    let scratch = Scratch::new();
    let program = elf_for(&scratch, "own_pins", "atmega328p");
    let (script, vcd) = (scratch.path("own.txt"), scratch.path("own.vcd"));
    fs::write(&script, "(0.3) set D7 high\n(0.4) set A1 1.5V\n(0.5) set D4 low\n").unwrap();
    let options = ["--watch", "D8,D5,D6", "--set", "D7=low", "--set", "A1=2.5V"];
    let files = ["--script", script.to_str().unwrap(), "--vcd", vcd.to_str().unwrap()];
    let output = lines(&sim(&program, &[&UNO[..], &options, &files].concat()));
    let seen: Vec<(f64, &str)> = output
        .lines()
        .filter_map(|line| line.split_once(" pin     "))
        .map(|(time, text)| (time.trim().parse().expect("seconds"), text))
        .collect();
    let at = |text: &str| {
        let found = seen.iter().rfind(|(_, shown)| *shown == text);
        found.unwrap_or_else(|| panic!("no {text} in {output}")).0
    };
    assert_eq!(at("D8 low"), 0.0, "the button is pressed");
    assert!((0.3..0.302).contains(&at("D8 high")), "{output}");
    assert!(at("D5 high") < 0.002 && (0.4..0.402).contains(&at("D5 low")), "{output}");
    let tone = seen.iter().find(|(_, text)| text.starts_with("D6") && text.contains("Hz"));
    let (_, tone) = tone.unwrap_or_else(|| panic!("no tone in {output}"));
    assert!(tone.ends_with("Hz, high 50 %"), "{tone}");
    assert!(seen.len() < 16, "the tone is one line: {output}");
    let waves = fs::read_to_string(&vcd).unwrap();
    for pin in ["D8", "D5", "D6"] {
        assert!(waves.contains(&format!(" {pin} $end")), "{pin} in the VCD file");
    }
    let save = fs::read_to_string(scratch.path("own.gtkw")).unwrap();
    for line in [&format!("[dumpfile] \"{}\"", vcd.canonicalize().unwrap().display()), "node.CAN"] {
        assert!(save.lines().any(|other| other == line), "{line} in {save}");
    }
    assert!(save.contains("\nnode.D8\n"), "{save}");
    // What GTKWave has saved stays.
    fs::write(scratch.path("own.gtkw"), "[*] GTKWave Analyzer v3.3\n").unwrap();
    lines(&sim_for("10ms", &program, &[&UNO[..], &files].concat()));
    let save = fs::read_to_string(scratch.path("own.gtkw")).unwrap();
    assert_eq!(save, "[*] GTKWave Analyzer v3.3\n");
}

#[test]
fn a_disturbed_chip_gives_no_hint_about_its_program() {
    let options = ["--strict", "--inject", "chip-garbage@1s"];
    let text = lines(&beside_autopilot("3s", &node_elf().unwrap(), &options));
    assert!(text.contains("fault   chip-garbage") && !text.contains("HINT"), "{text}");
}

/// Two nodes with one ID would break the rules of the bus.
#[test]
fn further_boards_have_node_ids_of_their_own() {
    let text = lines(&sim_for("2500ms", &node_elf().unwrap(), &["--nodes", "2"]));
    for id in 120..=122 {
        assert!(text.contains(&format!("node {id}: OK OPERATIONAL up 1 s")), "{text}");
    }
    assert!(text.contains(" 0 error frames"), "{text}");
}
