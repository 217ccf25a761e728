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

/// Fails at the first line in which the traces differ, and leaves them in the target directory.
#[track_caller]
pub fn assert_equal(name: &str, first: (&str, &str), second: (&str, &str)) {
    let (ours, theirs): (Vec<_>, Vec<_>) = (first.1.lines().collect(), second.1.lines().collect());
    let same = ours.iter().zip(&theirs).take_while(|(a, b)| a == b).count();
    if same == ours.len() && same == theirs.len() {
        return;
    }
    for (processor, trace) in [first, second] {
        let path = target_dir().join(format!("{name}.{processor}.trace"));
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
