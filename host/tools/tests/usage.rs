//! The command lines of both programs.

use std::process::Command;

#[test]
fn a_wrong_command_line_has_exit_code_2_and_names_the_mistake() {
    let (update, check) = (env!("CARGO_BIN_EXE_node-update"), env!("CARGO_BIN_EXE_node-check"));
    for (program, words, named) in [
        (update, &["missing.bin", "--node", "128"][..], "128"),
        (check, &["--bus", "mcast:256"], "mcast:256"),
    ] {
        let output = Command::new(program).args(words).output().expect("it starts");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{errors}");
        assert!(errors.contains(named), "{errors}");
    }
}
