//! Tests of the exit codes of `sim utilisation`.

use std::fs;

use crate::links::{Scratch, sim};

#[test]
fn the_exit_code_is_2_for_a_wrong_command_line_or_file_and_3_for_a_missing_file() {
    let scratch = Scratch::new();
    let (wrong, binary) = (scratch.path("wrong"), scratch.path("binary"));
    fs::write(&wrong, "NodeStatus@1\nNodeStatus@0\n").expect("a file");
    fs::write(&binary, [0xFF, 0xFE, 0x00]).expect("a file");
    let (directory, nowhere) = (scratch.path(""), scratch.path("nowhere"));
    let [wrong, binary, directory, nowhere] =
        [&wrong, &binary, &directory, &nowhere].map(|path| path.to_str().expect("text"));
    for (arguments, code, text) in [
        (&["--message", "NodeStatus:8@1"][..], 2, "NodeStatus has 7 bytes, not 8"),
        (&["--message", "NodeStatus=2A000000000000@0.1"], 0, ""),
        (&["--tables", "--message", "NodeStatus@1"], 2, ""),
        (&["--list", "--file", "x"], 2, ""),
        (&["--tables", "--list"], 2, ""),
        (&["--file", wrong], 2, wrong),
        (&["--file", binary], 2, binary),
        (&["--file", directory], 2, directory),
        (&["--file", nowhere], 3, nowhere),
    ] {
        let (found, _, error) = sim(&[&["utilisation"], arguments].concat());
        assert_eq!(found, Some(code), "{arguments:?}: {error}");
        assert!(error.contains(text), "{arguments:?}: {error}");
    }
}
