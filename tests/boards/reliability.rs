//! docs/reliability.md is what `make reliability` writes, and its measurements are within their
//! limits.

use rig::faults::Measured;
use rig::faults::page::page;

/// Parses a cell such as "53 (1000)": the measurement and its limit.
fn numbers(cell: &str) -> Option<(f64, f64)> {
    let (measured, limit) = cell.strip_suffix(')')?.split_once(" (")?;
    Some((measured.parse().ok()?, limit.parse().ok()?))
}

/// The lines of the page, without the commit and the measurements.
fn without_measurements(page: &str) -> Vec<String> {
    let cell = |cell: &str| match numbers(cell) {
        Some((measured, limit)) => {
            assert!(measured <= limit, "{measured} of {limit} ms");
            format!("({limit})")
        }
        None => cell.to_owned(),
    };
    let lines = page.lines().filter(|line| !line.starts_with("Measured on "));
    let cells = |line: &str| -> Vec<String> {
        line.trim_end_matches(" |").split(" | ").map(cell).collect()
    };
    lines.map(|line| cells(line).join(" | ")).collect()
}

#[test]
fn the_page_has_every_fault_with_its_limits_and_the_text_that_the_program_writes() {
    let written = page(|_| Measured { logged_ms: Some(0.0), recovery_ms: 0.0 });
    let found = without_measurements(include_str!("../../docs/reliability.md"));
    let expected = without_measurements(&written);
    for (found, expected) in found.iter().zip(&expected) {
        assert_eq!(found, expected, "make reliability");
    }
    assert_eq!(found.len(), expected.len(), "make reliability");
}
