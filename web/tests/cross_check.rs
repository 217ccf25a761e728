//! Compares the page's WebAssembly, whose processor is the own core, with simavr: the same program,
//! board, bus and traffic on both, line by line.
//!
//! `make cross-check` builds what the test needs and runs it. `CROSS_SECONDS` is the simulated time
//! of each program, 9 by default, and `CROSS_SEED` the seed of the traffic. The WebAssembly runs in
//! Node.js; with `CROSS_BROWSER` in Chromium.

#[macro_use]
mod trace;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use bench::avr::{Avr, Firmware};
use bench::{firmware_for, target_dir};
use trace::{assert_equal, number};
use web::scenario::{self, Traffic};

/// The trace of the WebAssembly, from Node.js or a browser.
fn in_webassembly(
    elf: &PathBuf,
    traffic: &str,
    seconds: u64,
    seed: u64,
) -> impl FnOnce() -> String {
    let build = target_dir().join("web-build");
    let in_browser = Path::new(env!("CARGO_MANIFEST_DIR")).join("check/browser.mjs");
    let program = match std::env::var_os("CROSS_BROWSER") {
        Some(_) => in_browser,
        None => build.join("run.mjs"),
    };
    assert!(program.exists(), "{} is missing: run \"make cross-check\"", program.display());
    let child = Command::new("node")
        .arg(program)
        .arg(build.join("pkg/web_bg.wasm"))
        .arg(elf)
        .args([traffic, &seconds.to_string(), &seed.to_string()])
        .stdout(Stdio::piped())
        .spawn()
        .expect("Node.js starts");
    move || {
        let output = child.wait_with_output().expect("Node.js ends");
        assert!(output.status.success(), "Node.js failed");
        String::from_utf8(output.stdout).expect("the trace is text")
    }
}

#[track_caller]
fn compare(board: &str, preset: &str, traffic: &str) {
    let (seconds, seed) = (number("CROSS_SECONDS", 9), number("CROSS_SEED", 1));
    assert!(seconds >= 3, "CROSS_SECONDS={seconds}: use 3 or more. A pulse comes after two");
    let elf = firmware_for(board, "seeed", preset).expect("the firmware");
    let other = in_webassembly(&elf, traffic, seconds, seed);
    let firmware = Firmware::read(&elf).expect("an ELF file");
    let avr = Avr::with_firmware(&firmware).expect("a program for a known chip");
    let kind = Traffic::named(traffic).expect("a traffic");
    let trace = scenario::run(avr, &firmware, kind, seconds, seed).expect("a possible wiring");
    assert_equal(preset, ("WebAssembly", &other()), ("simavr", &trace));
}

each_program!(compare);
