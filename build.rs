//! Tells the program its board and its commit, and the linker its limits.
//!
//! The board is the one that NODE_BOARD and NODE_SHIELD name in avr-specs/boards.toml, or the
//! table's default. NODE_CS, NODE_INT and NODE_CRYSTAL_MHZ replace the wiring of the CAN board.
//! scripts/firmware sets them. `src/hardware.rs` reads what this program finds. The limits are
//! those of the chip in avr-specs/budget.toml.

use std::process::Command;

use toml::{Table, Value};

const SPECS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/avr-specs");

/// Minor hardware version of wiring that no entry of the table has.
const OWN_WIRING: i64 = 255;

/// Analogue inputs of the feature `power`: voltage and current.
const POWER_INPUTS: usize = 2;

/// Outputs of the feature `outputs` besides the servo's.
const MORE_OUTPUTS: usize = 7;

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
        limit_sizes(&chip);
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
fn describe_board() -> String {
    let table = table("boards.toml");
    let board = chosen("NODE_BOARD", || text(&table, &["default_board"]));
    let shield = chosen("NODE_SHIELD", || text(&table, &["default_shield"]));
    let cs = chosen("NODE_CS", || text(&table, &["shields", &shield, "cs"]));
    let interrupt = chosen("NODE_INT", || text(&table, &["shields", &shield, "int"]));
    let crystal_mhz =
        chosen("NODE_CRYSTAL_MHZ", || text(&table, &["shields", &shield, "crystal_mhz"]));
    let chip = text(&table, &["boards", &board, "chip"]);

    let pins = &table["pins"];
    let servos = pins["servo"].as_array().expect("avr-specs/boards.toml: pins.servo is a list");
    let servo = servos
        .iter()
        .filter_map(Value::as_str)
        .find(|pin| *pin != cs)
        .expect("a pin for the servo");
    let outputs =
        pins["outputs"].as_array().expect("avr-specs/boards.toml: pins.outputs is a list");
    let power = pins["power"].as_array().expect("avr-specs/boards.toml: pins.power is a list");
    let power: Vec<&str> = power
        .iter()
        .filter_map(Value::as_str)
        .filter(|pin| *pin != cs)
        .take(POWER_INPUTS)
        .collect();
    assert_eq!(power.len(), POWER_INPUTS, "avr-specs/boards.toml: pins.power has too few pins");
    let is_free = |pin: &&str| *pin != cs && *pin != servo && !power.contains(pin);
    let outputs: Vec<&str> =
        outputs.iter().filter_map(Value::as_str).filter(is_free).take(MORE_OUTPUTS).collect();
    assert_eq!(outputs.len(), MORE_OUTPUTS, "avr-specs/boards.toml: pins.outputs has too few pins");
    let rpm = pins["rpm"].as_array().expect("avr-specs/boards.toml: pins.rpm is a list");
    let rpm = rpm
        .iter()
        .filter_map(Value::as_str)
        .find(|pin| *pin != interrupt)
        .filter(|_| std::env::var_os("CARGO_FEATURE_RPM").is_some())
        .unwrap_or_default();
    let light =
        Some(text(&table, &["pins", "light"])).filter(|light| *light != interrupt && *light != rpm);
    let has_entry = |shield: &&Value| {
        let is =
            |key: &str, value: &str| shield.get(key).is_some_and(|entry| plain(entry) == value);
        is("cs", &cs) && is("int", &interrupt) && is("crystal_mhz", &crystal_mhz)
    };
    let shields = table["shields"].as_table().expect("avr-specs/boards.toml: shields is a table");
    let minor = shields.values().find(has_entry).and_then(|shield| shield.get("hardware_minor"));

    set("NODE_BOARD", &board);
    set("NODE_SHIELD", &shield);
    set("NODE_CHIP", &chip);
    set("NODE_CS", &cs);
    set("NODE_INT", &interrupt);
    set("NODE_CRYSTAL_MHZ", &crystal_mhz);
    set("NODE_SERVO", servo);
    set("NODE_OUTPUTS", &outputs.join(","));
    set("NODE_POWER", &power.join(","));
    set("NODE_RPM", rpm);
    set("NODE_LIGHT", light.as_deref().unwrap_or_default());
    set("NODE_BUTTON", &text(&table, &["pins", "button"]));
    set("NODE_SENSOR", &text(&table, &["pins", "sensor"]));
    set("NODE_NAME", &text(&table, &["chips", &chip, "node_name"]));
    set("NODE_HARDWARE_MAJOR", &text(&table, &["chips", &chip, "hardware_major"]));
    set("NODE_LANES", &text(&table, &["chips", &chip, "lanes"]));
    set(
        "NODE_HARDWARE_MINOR",
        &minor.and_then(Value::as_integer).unwrap_or(OWN_WIRING).to_string(),
    );
    let number = if interrupt == "D3" { 1 } else { 0 };
    println!("cargo::rustc-cfg=can_interrupt=\"INT{number}\"");
    chip
}

/// What an environment variable chooses, or the default.
fn chosen(name: &str, default: impl FnOnce() -> String) -> String {
    println!("cargo::rerun-if-env-changed={name}");
    std::env::var(name).ok().filter(|value| !value.is_empty()).unwrap_or_else(default)
}

/// A file of avr-specs.
fn table(file: &str) -> Table {
    let text = std::fs::read_to_string(format!("{SPECS}/{file}"))
        .unwrap_or_else(|error| panic!("avr-specs/{file}: {error}"));
    text.parse().unwrap_or_else(|error| panic!("avr-specs/{file}: {error}"))
}

/// An entry of the table, as text.
fn text(table: &Table, path: &[&str]) -> String {
    let (first, rest) = path.split_first().expect("a path");
    let found = table
        .get(*first)
        .and_then(|value| rest.iter().try_fold(value, |value, key| value.get(key)));
    plain(found.unwrap_or_else(|| panic!("avr-specs/boards.toml has no {}", path.join("."))))
}

/// A text or a number of the table, as text.
fn plain(value: &Value) -> String {
    let number =
        || value.as_integer().expect("avr-specs/boards.toml has texts and numbers").to_string();
    value.as_str().map_or_else(number, str::to_owned)
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
