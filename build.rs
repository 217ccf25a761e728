//! Finds the commit for GetNodeInfo: the first eight digits of git's HEAD, or zero where there is no repository. And has the linker
//! check where the constants are.

use std::process::Command;

fn main() {
    let commit = Command::new("git")
        .args(["rev-parse", "--short=8", "HEAD"])
        .output()
        .ok()
        .filter(|output| output.status.success())
        .and_then(|output| String::from_utf8(output.stdout).ok());
    println!("cargo::rustc-env=NODE_COMMIT={}", commit.as_deref().unwrap_or("0").trim().get(..8).unwrap_or("0"));
    if std::env::var("CARGO_CFG_TARGET_ARCH").as_deref() == Ok("avr") {
        let specs = concat!(env!("CARGO_MANIFEST_DIR"), "/avr-specs");
        println!("cargo::rustc-link-arg-bin=node={specs}/image.ld");
        println!("cargo::rerun-if-changed=avr-specs");
    }
    // The reflog changes with every commit, checkout and merge.
    println!("cargo::rerun-if-changed=.git/logs/HEAD");
    println!("cargo::rerun-if-changed=build.rs");
}
