//! What the benchmarks write into documents.

use std::process::Command;

use bench::root;

/// The line that says which firmware a page or a part of it is about. `scripts/docs --measured`
/// compares that commit with the sources.
pub fn measured() -> String {
    let description = Command::new("git")
        .args(["describe", "--always", "--dirty", "--abbrev=8", "--exclude=*"])
        .current_dir(root())
        .output();
    let commit = match description {
        Ok(output) if output.status.success() => String::from_utf8_lossy(&output.stdout).into(),
        _ => "unknown".to_owned(),
    };
    format!("Measured on commit `{}`.", commit.trim())
}

/// Replaces the part of docs/benchmarks.md with this heading, or appends it, with the commit at its
/// end.
///
/// # Panics
/// If the page cannot be read or written.
pub fn write_part(heading: &str, part: &str) {
    let path = root().join("docs/benchmarks.md");
    let page = std::fs::read_to_string(&path)
        .unwrap_or_else(|error| panic!("{} cannot be read: {error}", path.display()));
    let part = format!("{}\n\n{}\n", part.trim_end(), measured());
    let page = replace_part(&page, heading, &part);
    std::fs::write(&path, page)
        .unwrap_or_else(|error| panic!("{} cannot be written: {error}", path.display()));
}

/// The page with this part in place of the one with the heading, or after the others.
fn replace_part(page: &str, heading: &str, part: &str) -> String {
    let begins = |at: usize| at + page[at..].find("\n## ").map_or(page[at..].len(), |end| end + 1);
    let (before, after) = match page.find(heading) {
        Some(at) => (&page[..at], &page[begins(at)..]),
        None => (page, ""),
    };
    let gap = if after.is_empty() { "" } else { "\n" };
    let before = before.trim_end();
    format!("{before}\n\n{part}{gap}{after}")
}
