//! Tells the program its board and its commit, and the linker its limits.
//!
//! The board is the one that NODE_BOARD and NODE_SHIELD name in avr-specs/boards.toml, or the
//! table's default. NODE_CS, NODE_INT and NODE_CRYSTAL_MHZ replace the wiring of the CAN board.
//! scripts/firmware sets them. avr-specs/boards.rs reads the table, and `src/hardware.rs` what this
//! program says. The limits are those of the chip in avr-specs/budget.toml.

#[path = "avr-specs/boards.rs"]
#[allow(dead_code)] // The bench uses the rest.
mod boards;

use std::process::Command;

use boards::Choice;
use toml::{Table, Value};

const SPECS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/avr-specs");

fn main() {
    let commit = git(&["rev-parse", "--short=8", "HEAD"]);
    set("NODE_COMMIT", commit.as_deref().and_then(|digits| digits.get(..8)).unwrap_or("0"));
    let chip = describe_board();
    println!("cargo::rustc-check-cfg=cfg(chip, values(\"atmega168\", \"atmega328p\"))");
    println!("cargo::rustc-check-cfg=cfg(can_interrupt, values(\"INT0\", \"INT1\"))");
    if std::env::var("CARGO_CFG_TARGET_ARCH").as_deref() == Ok("avr") {
        let target = std::env::var("TARGET").expect("cargo names the target");
        assert_eq!(
            target,
            format!("avr-{chip}"),
            "the board has another chip: build by \"make firmware BOARD=...\""
        );
        println!("cargo::rustc-cfg=chip=\"{chip}\"");
        limit_sizes(chip);
    }
    // The reflog changes with every commit, checkout and merge. A worktree has its own.
    if let Some(reflog) = git(&["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo::rerun-if-changed={reflog}");
    }
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=avr-specs");
}

/// Gives the program a variable that `env!` reads.
fn set(name: &str, value: &str) {
    println!("cargo::rustc-env={name}={value}");
}

/// What a git command prints, if there is a repository.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git")
        .args(arguments)
        .output()
        .ok()
        .filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}

/// Describes the board to `src/hardware.rs`. Returns the name of its chip.
fn describe_board() -> &'static str {
    for name in boards::VARIABLES {
        println!("cargo::rerun-if-env-changed={name}");
    }
    let choice = Choice::of_environment(|name| std::env::var(name).ok());
    let chip = choice.chip();
    let entry = boards::entry("chips", chip);
    let rpm = choice.rpm().filter(|_| std::env::var_os("CARGO_FEATURE_RPM").is_some());
    set("NODE_BOARD", &choice.board);
    set("NODE_SHIELD", &choice.shield);
    set("NODE_CHIP", chip);
    set("NODE_CS", &choice.cs);
    set("NODE_INT", &choice.int);
    set("NODE_CRYSTAL_MHZ", &choice.crystal_mhz.to_string());
    set("NODE_SERVO", choice.servo());
    set("NODE_OUTPUTS", &choice.outputs().join(","));
    set("NODE_POWER", &choice.power().join(","));
    set("NODE_RPM", rpm.unwrap_or_default());
    set("NODE_LIGHT", choice.light(rpm).unwrap_or_default());
    set("NODE_BUTTON", boards::pin("button"));
    set("NODE_SENSOR", boards::pin("sensor"));
    set("NODE_NAME", boards::text(entry, "node_name"));
    set("NODE_HARDWARE_MAJOR", &boards::number(entry, "hardware_major").to_string());
    set("NODE_HARDWARE_MINOR", &choice.hardware_minor().to_string());
    set("NODE_LANES", &boards::number(entry, "lanes").to_string());
    let number = if choice.int == "D3" { 1 } else { 0 };
    println!("cargo::rustc-cfg=can_interrupt=\"INT{number}\"");
    chip
}

/// A file of avr-specs.
fn table(file: &str) -> Table {
    let text = std::fs::read_to_string(format!("{SPECS}/{file}"))
        .unwrap_or_else(|error| panic!("avr-specs/{file}: {error}"));
    text.parse().unwrap_or_else(|error| panic!("avr-specs/{file}: {error}"))
}

/// Hands the limits of the chip to the linker.
fn limit_sizes(chip: &str) {
    let budget = table("budget.toml");
    let limit = |name: &str| {
        let bytes = budget.get(chip).and_then(|chip| chip.get(name)).and_then(Value::as_integer);
        bytes.unwrap_or_else(|| panic!("avr-specs/budget.toml has no {name} of {chip}"))
    };
    // The target says that nothing is allowed above the limits; scripts/firmware allows more for
    // firmware that is not for a chip. It cannot replace a limit, because of two definitions
    // the later one counts, and cargo puts these last.
    set("NODE_BOOT_SECTION", &limit("flash").to_string());
    for argument in [
        format!("-Wl,--defsym=__TEXT_REGION_LENGTH__={}+__ABOVE_LIMITS__", limit("flash")),
        format!("-Wl,--defsym=__DATA_REGION_LENGTH__={}+__ABOVE_LIMITS__", limit("statics")),
    ] {
        println!("cargo::rustc-link-arg-bin=servo-node={argument}");
    }
    // The stack begins below the RAM that the bootloader shares with the program (`SHARED_RAM` in
    // src/handover.rs).
    const SHARED_RAM: i64 = 32;
    println!(
        "cargo::rustc-link-arg-bin=servo-node=-Wl,--defsym=__stack={}",
        limit("ram_end") - SHARED_RAM - 1
    );
}
