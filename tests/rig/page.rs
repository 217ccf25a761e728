//! What the benchmarks write into documents.

use std::ops::Range;
use std::path::PathBuf;
use std::process::Command;

use bench::root;

/// The commit of the sources, with "-dirty" if some have changed since: not the documents, which
/// the measurements write themselves.
pub fn commit() -> String {
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).current_dir(root()).output().ok()?;
        let text = String::from_utf8_lossy(&output.stdout).trim().to_owned();
        output.status.success().then_some(text)
    };
    let Some(commit) = git(&["rev-parse", "--short=8", "HEAD"]) else {
        return "unknown".to_owned();
    };
    match git(&["diff", "--quiet", "HEAD", "--", ".", ":!docs"]) {
        Some(_) => commit,
        None => format!("{commit}-dirty"),
    }
}

/// The line that says which firmware a page or a part of it is about. `scripts/docs --measured`
/// compares that commit with the sources.
pub fn measured() -> String {
    format!("Measured on commit `{}`.", commit())
}

fn read() -> String {
    let path = path();
    std::fs::read_to_string(&path)
        .unwrap_or_else(|error| panic!("{} cannot be read: {error}", path.display()))
}

fn path() -> PathBuf {
    root().join("docs/benchmarks.md")
}

/// The part of docs/benchmarks.md with this heading: empty if there is none.
///
/// # Panics
/// If the page cannot be read.
pub fn read_part(heading: &str) -> String {
    let page = read();
    place(&page, heading).map_or(String::new(), |place| page[place].to_owned())
}

/// Replaces the part of docs/benchmarks.md with this heading, or appends it.
///
/// # Panics
/// If the page cannot be read or written.
pub fn write_part(heading: &str, part: &str) {
    let page = replace_part(&read(), heading, &format!("{}\n", part.trim_end()));
    let path = path();
    std::fs::write(&path, page)
        .unwrap_or_else(|error| panic!("{} cannot be written: {error}", path.display()));
}

/// Where the part with this heading is, with the heading.
fn place(page: &str, heading: &str) -> Option<Range<usize>> {
    let begin = page.find(heading)?;
    let end = page[begin..].find("\n## ").map_or(page.len(), |end| begin + end + 1);
    Some(begin..end)
}

/// The page with this part in place of the one with the heading, or after the others.
fn replace_part(page: &str, heading: &str, part: &str) -> String {
    let (before, after) = match place(page, heading) {
        Some(place) => (&page[..place.start], &page[place.end..]),
        None => (page, ""),
    };
    let gap = if after.is_empty() { "" } else { "\n" };
    let before = before.trim_end();
    format!("{before}\n\n{part}{gap}{after}")
}
