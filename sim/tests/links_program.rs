//! Tests of the program `sim` with ports: their removal at its end, errors, and an upload through
//! the original bootloaders.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use crate::links::{Client, Scratch, elf, elf_for};

/// Directory of the bootloaders in Debian's package arduino-core-avr.
const BOOTLOADERS: &str = "/usr/share/arduino/hardware/arduino/avr/bootloaders/atmega";
/// Longest real time of a wait.
const TIMEOUT: Duration = Duration::from_secs(60);

/// A running simulator. Killed on drop.
struct Sim(Child);

impl Sim {
    fn start(options: &[&str]) -> Sim {
        let child = sim(options).stdout(Stdio::null()).spawn().expect("sim starts");
        Sim(child)
    }

    fn signal(&self, name: &str) {
        let sent =
            Command::new("kill").args([&format!("-{name}"), &self.0.id().to_string()]).status();
        assert!(sent.expect("kill").success());
    }

    fn end(&mut self) -> bool {
        wait_for(|| self.0.try_wait().expect("a child").is_some(), "sim to end");
        self.0.wait().expect("a child").success()
    }
}

impl Drop for Sim {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The command `sim`, limited to 3 minutes, so that it ends even if the test is killed.
fn sim(options: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sim"));
    if !options.contains(&"--for") {
        command.args(["--for", "3m"]);
    }
    command.arg("--plain").args(options);
    command
}

#[track_caller]
fn wait_for(mut condition: impl FnMut() -> bool, what: &str) {
    let start = Instant::now();
    while !condition() {
        assert!(start.elapsed() < TIMEOUT, "time-out while waiting for {what}");
        thread::sleep(Duration::from_millis(10));
    }
}

#[track_caller]
fn assert_fails(options: &[&str], expected: &str) {
    let Output { status, stderr, .. } = sim(options).output().expect("sim starts");
    let stderr = String::from_utf8_lossy(&stderr);
    assert!(!status.success() && stderr.contains(expected), "{stderr}");
}

fn is_link(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok()
}

/// A path as an option.
fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_signal_ends_the_run_and_removes_the_ports() {
    let scratch = Scratch::new();
    let program = elf(&scratch, "echo");
    let (can, serial) = (scratch.path("can"), scratch.path("serial"));
    for signal in ["INT", "TERM", "HUP"] {
        let ports = ["--slcan", text(&can), "--serial", text(&serial)];
        let mut sim = Sim::start(&[&["--elf", text(&program)], &ports[..]].concat());
        wait_for(|| is_link(&can) && is_link(&serial), "the ports");
        sim.signal(signal);
        assert!(sim.end(), "{signal}");
        assert!(!is_link(&can) && !is_link(&serial), "{signal}");
    }
}

/// A killed simulator leaves its port behind.
#[test]
fn the_port_of_a_killed_run_is_replaced_and_that_of_a_running_one_is_not() {
    let scratch = Scratch::new();
    let (program, port) = (elf(&scratch, "echo"), scratch.path("can"));
    let options = ["--elf", text(&program), "--slcan", text(&port)];
    let mut first = Sim::start(&options);
    wait_for(|| is_link(&port), "the port");
    assert_fails(&options, "another sim");
    first.0.kill().unwrap();
    first.0.wait().unwrap();
    assert!(is_link(&port));
    let stale = fs::read_link(&port).unwrap();
    let _second = Sim::start(&options);
    let is_new = || fs::read_link(&port).is_ok_and(|found| found != stale || found.exists());
    wait_for(is_new, "the new port");
}

#[test]
fn the_error_of_an_option_that_cannot_be_fulfilled_gives_advice() {
    let scratch = Scratch::new();
    let (program, file) = (elf(&scratch, "echo"), scratch.path("thesis.txt"));
    let (program, port) = (text(&program), scratch.path("s"));
    fs::write(&file, "a thesis").unwrap();
    for (options, expected) in [
        (&["--elf", program, "--slcan", text(&file)][..], "choose another path"),
        (&["--elf", program, "--serial", "/no/such/place"], "no directory"),
        (&["--elf", program, "--eeprom", text(&file)], "8 bytes"),
        (&["--serial", text(&port), "--bootloader", program], program),
        (&["--elf", "/no/such.elf"], "make firmware"),
    ] {
        assert_fails(options, expected);
    }
    assert_eq!(fs::read(&file).unwrap(), b"a thesis");
    assert!(!is_link(&port));
}

fn bootloader(name: &str) -> Option<PathBuf> {
    let path = Path::new(BOOTLOADERS).join(name);
    let there =
        path.exists() && Command::new("avrdude").arg("-v").stderr(Stdio::null()).status().is_ok();
    if !there {
        eprintln!("skipped: needs avrdude and {} (Debian: arduino-core-avr)", path.display());
    }
    there.then_some(path)
}

#[test]
fn avrdude_uploads_through_the_original_bootloaders() {
    upload("ATmegaBOOT_168_diecimila.hex", "diecimila", "atmega168", ["m168", "19200"]);
    upload("ATmegaBOOT_168_atmega328.hex", "duemilanove", "atmega328p", ["m328p", "57600"]);
}

#[test]
fn a_bootloader_that_is_too_long_is_named_with_one_that_fits() {
    let Some(hex) = bootloader("../optiboot/optiboot_atmega328.hex") else { return };
    let options = ["--board", "uno", "--no-program", "--bootloader", text(&hex)];
    assert_fails(&options, &format!("the bootloader {}: 32,788 bytes", hex.display()));
    assert_fails(&options, "scripts/optiboot compiles one that fits");
}

/// Without an ELF, and with only the program of a Diecimila built.
#[test]
fn a_board_runs_its_own_program_or_says_how_to_build_it() {
    let scratch = Scratch::new();
    fs::create_dir(scratch.path("firmware")).unwrap();
    let build = |chip: &str, name: &str| {
        fs::copy(elf_for(&scratch, "echo", chip), scratch.path("firmware").join(name)).unwrap();
    };
    let run = |options: &[&str]| {
        let mut sim = sim(&[&["--for", "10ms", "--no-autopilot"], options].concat());
        for variable in ["NODE_ELF", "NODE_BOARD", "NODE_SHIELD"] {
            sim.env_remove(variable);
        }
        let output = sim.env("CARGO_TARGET_DIR", scratch.path("")).output().expect("sim starts");
        let of = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (output.status.success(), of(&output.stdout) + &of(&output.stderr))
    };
    build("atmega168", "diecimila-seeed.elf");
    let (is_run, text) = run(&[]);
    assert!(is_run && text.contains("Diecimila (ATmega168)") && text.contains("ready"), "{text}");
    let (is_run, text) = run(&["--board", "uno"]);
    assert!(!is_run && text.contains("make firmware BOARD=uno SHIELD=seeed"), "{text}");
    build("atmega328p", "uno-seeed.elf");
    for (board, title) in [("uno", "Uno (ATmega328P)"), ("nano", "bootloader (ATmega328P)")] {
        let (is_run, text) = run(&["--board", board]);
        assert!(is_run && text.contains(title) && text.contains("ready"), "{text}");
    }
}

fn upload(hex: &str, board: &str, chip: &str, [part, baud]: [&str; 2]) {
    let Some(hex) = bootloader(hex) else { return };
    let scratch = Scratch::new();
    let (program, port) = (elf_for(&scratch, "echo", chip), scratch.path("arduino"));
    let serial = ["--serial", text(&port), "--bootloader", text(&hex)];
    let _sim = Sim::start(&[&serial[..], &["--no-program", "--board", board]].concat());
    wait_for(|| is_link(&port), "the port");
    let avrdude = Command::new("avrdude")
        .args(["-c", "arduino", "-p", part, "-b", baud, "-D", "-P", text(&port)])
        .args(["-U", &format!("flash:w:{}:e", program.display())])
        .output()
        .expect("avrdude");
    let output = String::from_utf8_lossy(&avrdude.stderr);
    assert!(avrdude.status.success() && output.contains("verified"), "{output}");
    // Opening the port resets the board again. The bootloader waits before it starts the program.
    let mut client = Client::open(&port);
    client.set_baud(115_200);
    let opened = Instant::now();
    let mut received = Vec::new();
    let mut ends_with = |client: &mut Client, end: &[u8]| {
        received.extend(client.read());
        received.ends_with(end)
    };
    wait_for(|| ends_with(&mut client, b"ready\n"), "the program to start");
    assert!(opened.elapsed() > Duration::from_millis(500), "the bootloader did not wait");
    client.write(b"hello");
    wait_for(|| ends_with(&mut client, b"hello"), "the echo");
}
