//! Parts of docs/benchmarks.md that different benchmarks write.

use bench::root;

/// Replaces the part of docs/benchmarks.md with this heading, or appends it.
///
/// # Panics
/// If the page cannot be read or written.
pub fn write_part(heading: &str, part: &str) {
    let path = root().join("docs/benchmarks.md");
    let page = std::fs::read_to_string(&path)
        .unwrap_or_else(|error| panic!("{} cannot be read: {error}", path.display()));
    let page = replace_part(&page, heading, part);
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
