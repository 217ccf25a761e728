//! Finds the commit for GetNodeInfo: the first eight digits of git's HEAD, or zero where there is no repository. For an AVR it also
//! hands the limits of avr-specs/budget.toml to the linker.

use std::process::Command;

const BUDGET: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/avr-specs/budget.toml");

fn main() {
    let commit = git(&["rev-parse", "--short=8", "HEAD"]);
    println!("cargo::rustc-env=NODE_COMMIT={}", commit.as_deref().and_then(|digits| digits.get(..8)).unwrap_or("0"));
    if std::env::var("CARGO_CFG_TARGET_ARCH").as_deref() == Ok("avr") {
        link();
    }
    // The reflog changes with every commit, checkout and merge. A worktree has its own.
    if let Some(reflog) = git(&["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo::rerun-if-changed={reflog}");
    }
    println!("cargo::rerun-if-changed=build.rs");
}

/// What a git command prints, if there is a repository.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}

fn link() {
    let target = std::env::var("TARGET").expect("cargo names the target");
    let chip = target.strip_prefix("avr-").expect("a target is avr-specs/avr-CHIP.json");
    let text = std::fs::read_to_string(BUDGET).unwrap_or_else(|error| panic!("{BUDGET}: {error}"));
    let budget: toml::Table = text.parse().unwrap_or_else(|error| panic!("{BUDGET}: {error}"));
    let limit = |name: &str| {
        let bytes = budget.get(chip).and_then(|chip| chip.get(name)).and_then(|bytes| bytes.as_integer());
        bytes.unwrap_or_else(|| panic!("{BUDGET} has no {name} of {chip}"))
    };
    // The target says that nothing is allowed above the limits; scripts/firmware allows more for firmware that is not for a chip. It
    // cannot replace a limit, because of two definitions the later one counts, and cargo puts these last.
    for argument in [
        format!("-Wl,--defsym=__TEXT_REGION_LENGTH__={}+__ABOVE_LIMITS__", limit("flash")),
        format!("-Wl,--defsym=__DATA_REGION_LENGTH__={}+__ABOVE_LIMITS__", limit("statics")),
    ] {
        println!("cargo::rustc-link-arg-bin=node={argument}");
    }
    println!("cargo::rerun-if-changed=avr-specs");
}
