//! What the comparisons of two traces share.

use bench::target_dir;

/// Lines before the first difference that a failure shows.
const CONTEXT: usize = 6;

/// The number in an environment variable.
pub fn number(variable: &str, default: u64) -> u64 {
    match std::env::var(variable) {
        Ok(text) if !text.is_empty() => text
            .parse()
            .unwrap_or_else(|_| panic!("{variable} is {text:?}: use a number, such as {default}")),
        _ => default,
    }
}

/// A test of each shipped program: its board, its preset and the traffic.
macro_rules! each_program {
    ($compare:ident) => {
        #[test]
        fn default_runs_alike_on_both() {
            $compare("diecimila", "default", "ardupilot");
        }

        #[test]
        fn remote_runs_alike_on_both() {
            $compare("diecimila", "remote", "px4");
        }

        #[test]
        fn thesis_runs_alike_on_both() {
            $compare("diecimila", "thesis", "thesis");
        }

        #[test]
        fn full_runs_alike_on_both() {
            $compare("uno", "full", "ardupilot");
        }
    };
}

/// Fails at the first line in which the traces of a preset differ, and leaves them in the target
/// directory; and if the second one lacks a kind of lines.
#[track_caller]
pub fn assert_equal(preset: &str, first: (&str, &str), second: (&str, &str)) {
    for kind in ["frame", "pulse", "serial", "eeprom"] {
        let count = second.1.lines().filter(|line| line.starts_with(kind)).count();
        println!("{preset}: {count} {kind} lines");
        // The preset remote has no serial monitor.
        assert!(count > 0 || (kind, preset) == ("serial", "remote"), "no {kind}");
    }
    let (ours, theirs): (Vec<_>, Vec<_>) = (first.1.lines().collect(), second.1.lines().collect());
    let same = ours.iter().zip(&theirs).take_while(|(a, b)| a == b).count();
    if same == ours.len() && same == theirs.len() {
        return;
    }
    for (processor, trace) in [first, second] {
        let path = target_dir().join(format!("{preset}.{processor}.trace"));
        std::fs::write(path, trace).expect("the target directory can be written");
    }
    let from = same.saturating_sub(CONTEXT);
    let part = |lines: &[&str]| {
        let end = (same + CONTEXT).min(lines.len());
        lines[from.min(end)..end].join("\n")
    };
    panic!(
        "{same} of {} lines are equal, then {}:\n{}\n\n{}:\n{}",
        ours.len(),
        first.0,
        part(&ours),
        second.0,
        part(&theirs)
    );
}
