//! Passes the chip to `board.rs`. The target's name has it: avr-CHIP.

fn main() {
    println!("cargo::rustc-check-cfg=cfg(chip, values(\"atmega168\", \"atmega328p\"))");
    let target = std::env::var("TARGET").expect("cargo names the target");
    if let Some(chip) = target.strip_prefix("avr-") {
        println!("cargo::rustc-cfg=chip=\"{chip}\"");
    }
    println!("cargo::rerun-if-changed=build.rs");
}
