//! docs/reliability.md lists every tested fault with its limits, its measurements are within the
//! limits, and its other lines are those that `make reliability` writes.

use rig::faults::Measured;
use rig::faults::page::{CHAPTERS, page, row};

/// Columns of the tables of faults.
const COLUMNS: usize = 6;

/// Parses a cell such as "53 (1000)": the measurement and its limit.
fn numbers(cell: &str) -> Option<(f64, f64)> {
    let (measured, limit) = cell.strip_suffix(')')?.split_once(" (")?;
    Some((measured.parse().ok()?, limit.parse().ok()?))
}

#[test]
fn the_page_has_every_fault_with_its_limits() {
    let page = include_str!("../../docs/reliability.md");
    let rows: Vec<Vec<&str>> = page
        .lines()
        .filter_map(|line| line.strip_prefix("| ")?.strip_suffix(" |"))
        .map(|line| line.split(" | ").collect())
        .filter(|cells: &Vec<&str>| cells.len() == COLUMNS)
        .collect();
    for case in CHAPTERS.iter().flat_map(|(_, cases)| *cases) {
        let expected = row(case, None);
        let found = rows.iter().find(|cells| cells[0] == expected[0]);
        let found = found
            .unwrap_or_else(|| panic!("{:?} is not on the page: make reliability", case.fault));
        for (cell, expected) in found.iter().zip(&expected) {
            match numbers(cell) {
                Some((measured, limit)) => {
                    assert!(
                        expected.ends_with(&format!("({limit})")),
                        "{:?}: make reliability",
                        case.fault
                    );
                    assert!(measured <= limit, "{:?}: {measured} of {limit} ms", case.fault);
                }
                None => assert_eq!(cell, expected, "{:?}: make reliability", case.fault),
            }
        }
    }
    let cases: usize = CHAPTERS.iter().map(|(_, cases)| cases.len()).sum();
    // Each chapter has two more rows: the head of the table.
    assert_eq!(rows.len(), cases + 2 * CHAPTERS.len(), "a fault on the page that is not tested");
}

#[test]
fn the_page_has_the_text_that_the_program_writes() {
    let text = |page: &str| -> Vec<String> {
        let is_text = |line: &&str| !line.starts_with("| ") && !line.starts_with("Measured on ");
        page.lines().filter(is_text).map(str::to_owned).collect()
    };
    let written = page(|_| Measured { logged_ms: None, recovery_ms: 0.0 });
    assert_eq!(text(include_str!("../../docs/reliability.md")), text(&written));
}
