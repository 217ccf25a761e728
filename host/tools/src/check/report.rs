//! The report: a row for each check, as Markdown for the form of an issue, and as JSON.

use std::fmt;

use serde_json::{Value, json};

/// The result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Passed,
    Failed,
    /// The check was not done. The row says why.
    Skipped,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Verdict::Passed => "passed",
            Verdict::Failed => "FAILED",
            Verdict::Skipped => "skipped",
        })
    }
}

/// A check: what it is about, what data sheet and simulator have, what the board showed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Row {
    pub what: &'static str,
    pub expected: String,
    pub seen: String,
    pub verdict: Verdict,
}

/// The line about the board that a person completes.
pub fn board() -> (&'static str, String) {
    let what = "Board, CAN board, stampings of the chips and the crystal, length of the bus";
    (what, "...".into())
}

/// What was checked, and the rows.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Names and values that head the report, such as the bus.
    pub about: Vec<(&'static str, String)>,
    pub rows: Vec<Row>,
    /// Why the checks ended before the last one.
    pub ended: Option<String>,
}

impl Report {
    /// The number of rows with this verdict.
    pub fn count(&self, verdict: Verdict) -> usize {
        self.rows.iter().filter(|row| row.verdict == verdict).count()
    }

    /// The result in a line.
    pub fn summary(&self) -> String {
        let [passed, failed, skipped] =
            [Verdict::Passed, Verdict::Failed, Verdict::Skipped].map(|verdict| self.count(verdict));
        let ended = self.ended.as_ref().map(|why| format!("; ended early: {why}"));
        format!("{passed} passed, {failed} failed, {skipped} skipped{}", ended.unwrap_or_default())
    }

    /// The report for an issue.
    pub fn markdown(&self) -> String {
        let cell = |text: &str| text.replace('|', "\\|").replace('\n', " ");
        let mut out = String::new();
        for (name, value) in &self.about {
            out += &format!("* {name}: {}\n", cell(value));
        }
        out += &format!("* Result: {}\n\n", cell(&self.summary()));
        out += "| what | expected (data sheet, simulator) | seen | verdict |\n";
        out += "| --- | --- | --- | --- |\n";
        for Row { what, expected, seen, verdict } in &self.rows {
            out += &format!("| {what} | {} | {} | {verdict} |\n", cell(expected), cell(seen));
        }
        out
    }

    /// The report for programs.
    pub fn json(&self) -> Value {
        let rows = self.rows.iter().map(|row| {
            json!({
                "what": row.what,
                "expected": row.expected,
                "seen": row.seen,
                "verdict": row.verdict.to_string().to_lowercase(),
            })
        });
        json!({
            "about": self.about,
            "rows": rows.collect::<Vec<_>>(),
            "ended": self.ended,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_cannot_break_the_table() {
        let row = Row {
            what: "Name",
            expected: "a".into(),
            seen: "b | c\nd".into(),
            verdict: Verdict::Failed,
        };
        let report = Report { rows: vec![row], ..Report::default() };
        assert!(report.markdown().ends_with("| Name | a | b \\| c d | FAILED |\n"));
        assert_eq!(report.json()["rows"][0]["verdict"], "failed");
        assert_eq!(report.summary(), "0 passed, 1 failed, 0 skipped");
    }
}
