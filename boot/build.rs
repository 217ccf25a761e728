//! Tells the linker where the boot section of the chip begins, and how long it is (avr-specs/budget.toml).

use toml::Table;

const BUDGET: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../avr-specs/budget.toml");

fn main() {
    println!("cargo::rerun-if-changed={BUDGET}");
    println!("cargo::rerun-if-changed=build.rs");
    let target = std::env::var("TARGET").expect("cargo names the target");
    let Some(chip) = target.strip_prefix("avr-") else { return };
    let text = std::fs::read_to_string(BUDGET).unwrap_or_else(|error| panic!("{BUDGET}: {error}"));
    let budget: Table = text.parse().unwrap_or_else(|error| panic!("{BUDGET}: {error}"));
    let limit = |name: &str| budget[chip][name].as_integer().unwrap_or_else(|| panic!("{BUDGET} has no {name}"));
    let (start, end, ram_end) = (limit("flash"), limit("flash_of_chip"), limit("ram_end"));
    println!("cargo::rustc-env=BOOT_SECTION={start}");
    println!("cargo::rustc-env=RAM_END={ram_end}");
    for argument in [
        // No vectors and no start-up code: `start.rs` has its own.
        "-nostartfiles".to_owned(),
        format!("-Wl,--section-start=.text={start:#x}"),
        format!("-Wl,--defsym=__TEXT_REGION_LENGTH__={end:#x}+__ABOVE_LIMITS__"),
        "-Wl,--entry=start".to_owned(),
    ] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
}
