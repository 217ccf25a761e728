//! `sim utilisation` refuses what no bus can have, with the exit code of a wrong command line.

use std::fs;
use std::process::Command;

/// The exit code, and what is said on the error output.
fn utilisation(arguments: &[&str]) -> (Option<i32>, String) {
    let output =
        Command::new(env!("CARGO_BIN_EXE_sim")).arg("utilisation").args(arguments).output().expect("sim starts");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn sizes_and_rates_that_no_transfer_has_are_refused_with_advice() {
    for (message, advice) in [
        ("NodeStatus:8@1", "NodeStatus has 7 bytes, not 8"),
        ("NodeStatus=2A00000000000000@1", "NodeStatus has 7 bytes, not 8"),
        ("ArrayCommand:61@1", "not 61"),
        ("NodeStatus@0", "is no rate"),
    ] {
        let (code, said) = utilisation(&["--message", message]);
        assert!(code == Some(2) && said.contains(advice), "{message}: {code:?} {said}");
    }
    assert_eq!(utilisation(&["--message", "NodeStatus=2A000000000000@0.1"]).0, Some(0));
}

#[test]
fn tables_and_list_stand_alone() {
    for arguments in
        [&["--tables", "--message", "NodeStatus@1"][..], &["--list", "--file", "x"], &["--tables", "--list"]]
    {
        assert_eq!(utilisation(arguments).0, Some(2), "{arguments:?}");
    }
}

#[test]
fn a_file_that_is_wrong_is_a_mistake_of_the_command_line() {
    let directory = std::env::temp_dir().join(format!("utilisation-{}", std::process::id()));
    fs::create_dir_all(&directory).expect("a directory");
    let (wrong, binary) = (directory.join("wrong"), directory.join("binary"));
    fs::write(&wrong, "NodeStatus@1\nNodeStatus@0\n").expect("a file");
    fs::write(&binary, [0xFF, 0xFE, 0x00]).expect("a file");
    for path in [&wrong, &binary, &directory] {
        let (code, said) = utilisation(&["--file", path.to_str().expect("text")]);
        assert!(code == Some(2) && said.contains(path.to_str().expect("text")), "{path:?}: {code:?} {said}");
    }
    let nowhere = directory.join("nowhere");
    assert_eq!(
        utilisation(&["--file", nowhere.to_str().expect("text")]).0,
        Some(3),
        "as for every file that is missing"
    );
    fs::remove_dir_all(&directory).expect("it is removed");
}
