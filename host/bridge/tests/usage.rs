//! Help and errors of the program. Because this test starts the program, cargo builds it with the
//! tests, and `tests/clients` can use it.

use std::process::Command;

/// Runs the program. Returns whether it succeeded, and its output.
fn bridge(arguments: &[&str]) -> (bool, String) {
    let output =
        Command::new(env!("CARGO_BIN_EXE_bridge")).args(arguments).output().expect("it starts");
    let printed = if output.status.success() { output.stdout } else { output.stderr };
    (output.status.success(), String::from_utf8(printed).expect("text"))
}

#[test]
fn each_topic_of_the_help_is_printed_and_another_one_refused() {
    for topic in ["bus", "channels", "rights", "tunnels", "output", "all"] {
        let (is_well, printed) = bridge(&["--help", topic]);
        assert!(is_well && printed.contains("--"), "{topic}: {printed}");
    }
    let (is_well, printed) = bridge(&["--help", "nonsense"]);
    assert!(!is_well && printed.contains("bus, channels, rights"), "{printed}");
}

#[test]
fn the_help_shows_examples_and_every_kind_of_bus_and_channel() {
    let (is_well, printed) = bridge(&["--help"]);
    assert!(is_well);
    let kinds = "slcan: mcast: socketcan: udpout: udpin: tcp: tcpin: serial:";
    for word in kinds.split(' ').chain(["bridge --bus "]) {
        assert!(printed.contains(word), "no {word} in\n{printed}");
    }
}

#[test]
fn a_wrong_key_is_answered_with_what_is_wrong() {
    let program = env!("CARGO_BIN_EXE_bridge");
    for (file, answer) in [
        ("/dev/zero", "cannot read the key in /dev/zero: it has more than 4096 bytes"),
        (program, "it has more than 4096 bytes"),
        ("/dev/null", "/dev/null has no key: write a passphrase into it"),
    ] {
        let (is_well, printed) =
            bridge(&["--bus", "mcast:0", "--mavlink", "udpin:0", "--signing-key", file]);
        assert!(!is_well && printed.contains(answer), "{file}: {printed}");
    }
}
