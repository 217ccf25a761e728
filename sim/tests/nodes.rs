//! Tests of `sim --nodes` with this project's firmware.

use std::process::Command;

use bench::node_elf;

/// Two nodes with one ID would break the rules of the bus.
#[test]
fn further_boards_have_node_ids_of_their_own() {
    let elf = node_elf().expect("the table has its defaults");
    assert!(elf.exists(), "{} is missing: run `make firmware`", elf.display());
    let output = Command::new(env!("CARGO_BIN_EXE_sim"))
        .args(["--plain", "--speed", "max", "--no-autopilot", "--nodes", "2", "--for", "2500ms"])
        .arg("--elf")
        .arg(elf)
        .output()
        .expect("sim starts");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}");
    for id in 120..=122 {
        assert!(text.contains(&format!("node {id}: OK OPERATIONAL up 1 s")), "{text}");
    }
    assert!(text.contains(" 0 error frames"), "{text}");
}
