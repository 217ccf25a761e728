//! Tests of `sim utilisation` with impossible sizes, rates and options.

use std::fs;
use std::process::Command;

/// The exit code, and the text on the error output.
fn utilisation(arguments: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_sim"))
        .arg("utilisation")
        .args(arguments)
        .output()
        .expect("sim starts");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn impossible_sizes_and_rates_are_rejected_with_advice() {
    for (message, advice) in [
        ("NodeStatus:8@1", "NodeStatus has 7 bytes, not 8"),
        ("NodeStatus=2A00000000000000@1", "NodeStatus has 7 bytes, not 8"),
        ("ArrayCommand:61@1", "not 61"),
        ("NodeStatus@0", "is not a rate"),
    ] {
        let (code, text) = utilisation(&["--message", message]);
        assert!(code == Some(2) && text.contains(advice), "{message}: {code:?} {text}");
    }
    assert_eq!(utilisation(&["--message", "NodeStatus=2A000000000000@0.1"]).0, Some(0));
}

#[test]
fn tables_and_list_allow_no_other_options() {
    for arguments in [
        &["--tables", "--message", "NodeStatus@1"][..],
        &["--list", "--file", "x"],
        &["--tables", "--list"],
    ] {
        assert_eq!(utilisation(arguments).0, Some(2), "{arguments:?}");
    }
}

#[test]
fn an_invalid_file_is_an_error_of_the_command_line_and_a_missing_one_is_not() {
    let directory = std::env::temp_dir().join(format!("utilisation-{}", std::process::id()));
    fs::create_dir_all(&directory).expect("a directory");
    let (wrong, binary) = (directory.join("wrong"), directory.join("binary"));
    fs::write(&wrong, "NodeStatus@1\nNodeStatus@0\n").expect("a file");
    fs::write(&binary, [0xFF, 0xFE, 0x00]).expect("a file");
    for path in [&wrong, &binary, &directory] {
        let (code, text) = utilisation(&["--file", path.to_str().expect("text")]);
        assert!(
            code == Some(2) && text.contains(path.to_str().expect("text")),
            "{path:?}: {code:?} {text}"
        );
    }
    let nowhere = directory.join("nowhere");
    assert_eq!(
        utilisation(&["--file", nowhere.to_str().expect("text")]).0,
        Some(3),
        "the exit code of a missing file"
    );
    fs::remove_dir_all(&directory).expect("it is removed");
}
