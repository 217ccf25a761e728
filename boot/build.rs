//! Tells the linker where the boot section of the chip begins, and how long it is
//! (avr-specs/budget.toml); and the program the baud rate of uploads (avr-specs/boards.toml). The
//! board's wiring comes from the node's library.

#[path = "../avr-specs/boards.rs"]
#[allow(dead_code)] // The bench uses the rest.
mod boards;

use boards::Choice;
use toml::Table;

const SPECS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../avr-specs");

fn main() {
    println!("cargo::rerun-if-changed={SPECS}");
    for name in boards::VARIABLES {
        println!("cargo::rerun-if-env-changed={name}");
    }
    println!("cargo::rerun-if-changed=build.rs");
    let target = std::env::var("TARGET").expect("cargo names the target");
    let Some(chip) = target.strip_prefix("avr-") else { return };
    let budget = table("budget.toml");
    let limit = |name: &str| budget[chip][name].as_integer().expect("a number");
    let choice = Choice::of_environment(|name| std::env::var(name).ok());
    let baud = boards::number(choice.board(), "upload_baud");
    println!("cargo::rustc-env=UPLOAD_BAUD={baud}");
    let (start, end, ram_end) = (limit("flash"), limit("flash_of_chip"), limit("ram_end"));
    println!("cargo::rustc-env=BOOT_SECTION={start}");
    // The variables of the loader end with what it shares with the program (src/handover.rs in the
    // root). These are the lengths of both parts.
    const VARIABLES: i64 = 347;
    const SHARED_RAM: i64 = 32;
    let variables = ram_end - SHARED_RAM - VARIABLES;
    println!("cargo::rustc-env=VARIABLES={variables}");
    println!("cargo::rustc-env=RAM_END={ram_end}");
    for argument in [
        // No vectors and no start-up code: `start.rs` has its own.
        "-nostartfiles".to_owned(),
        format!("-Wl,--section-start=.text={start:#x}"),
        format!("-Wl,--defsym=__TEXT_REGION_LENGTH__={end:#x}+__ABOVE_LIMITS__"),
        format!("-Wl,--section-start=.noinit={:#x}", 0x80_0000 + variables),
        "-Wl,--entry=start".to_owned(),
    ] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
}

/// A file of avr-specs.
fn table(file: &str) -> Table {
    let text = std::fs::read_to_string(format!("{SPECS}/{file}"))
        .unwrap_or_else(|error| panic!("avr-specs/{file}: {error}"));
    text.parse().unwrap_or_else(|error| panic!("avr-specs/{file}: {error}"))
}
