//! The traffic on the bus as lines, with a bounded history for each type of message.
//!
//! A frequent type pushes out only its own old lines, so the lines of rare types stay. A page
//! merges the histories of the types that the user has not hidden. Each line has a number, in order
//! of time. A page that is scrolled back stays on its numbers while new lines come.

use super::history::Log;
use bench::Cycles;
use std::collections::BTreeSet;
use std::fmt;

/// Most types with a history of their own. Further types share one history; only foreign or broken
/// nodes send so many.
const TYPES_MAX: usize = 32;
/// Name of the history that the types beyond `TYPES_MAX` share.
const FURTHER_TYPES: &str = "further types";

/// Names of the types that are not shown.
pub type Hidden = BTreeSet<String>;

/// Source of a line of traffic. The live view gives each its colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The node under test.
    Node,
    /// Any other station.
    Other,
    /// A valid CAN frame of another protocol than DroneCAN.
    Foreign,
    /// An invalid transfer of a known data type, or an error frame.
    Broken,
}

/// Name of a line of an error frame.
pub const ERROR_FRAME: &str = "error frame";

/// One transfer, foreign frame or error frame on the bus.
#[derive(Clone, Debug, PartialEq)]
pub struct TrafficLine {
    pub at: Cycles,
    pub origin: Origin,
    /// Sender as text: "1", "anon", "127>42", "-".
    pub who: String,
    /// Name of the message type. Lines of one name are counted together.
    pub name: String,
    /// Decoded content.
    pub text: String,
}

#[cfg(test)]
impl TrafficLine {
    /// A line of station 1.
    pub fn sample(at: Cycles, name: &str, text: &str) -> TrafficLine {
        let [who, name, text] = ["1", name, text].map(String::from);
        TrafficLine { at, origin: Origin::Other, who, name, text }
    }
}

/// Sender and content, as in the columns of the views.
impl fmt::Display for TrafficLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:>4} {}", self.who, self.text)
    }
}

/// A line and its number.
type Numbered = (u64, TrafficLine);

/// The lines of one type.
#[derive(Clone, Debug)]
pub struct MessageType {
    pub name: String,
    /// Number of lines so far. The history keeps only the newest.
    pub count: u64,
    lines: Log<Numbered>,
}

/// The histories of all types.
#[derive(Clone, Debug, Default)]
pub struct Traffic {
    /// In the order of their first lines, so that a list of the types does not move under the
    /// cursor.
    types: Vec<MessageType>,
    next_number: u64,
}

impl Traffic {
    /// Adds the newest line.
    pub fn push(&mut self, line: TrafficLine) {
        let index = self.index_of(&line.name);
        let message_type = &mut self.types[index];
        message_type.count += 1;
        message_type.lines.push((self.next_number, line));
        self.next_number += 1;
    }

    fn index_of(&mut self, name: &str) -> usize {
        let index_of =
            |types: &[MessageType], name: &str| types.iter().position(|known| known.name == name);
        let name = match index_of(&self.types, name) {
            Some(index) => return index,
            None if self.types.len() < TYPES_MAX => name,
            None => FURTHER_TYPES,
        };
        index_of(&self.types, name).unwrap_or_else(|| {
            self.types.push(MessageType { name: name.to_owned(), count: 0, lines: Log::default() });
            self.types.len() - 1
        })
    }

    /// The types, in the order of their first lines.
    pub fn types(&self) -> &[MessageType] {
        &self.types
    }

    /// The newest line.
    pub fn last(&self) -> Option<&TrafficLine> {
        self.before(self.next_number, &Hidden::new()).next().map(|(_, line)| line)
    }

    /// A page of `rows` lines of types that are not hidden, oldest first. It ends with line number
    /// `until`, or the newest line.
    pub fn page(&self, rows: usize, until: Option<u64>, hidden: &Hidden) -> Vec<&TrafficLine> {
        let end = self.end(until);
        let mut lines: Vec<_> = self.before(end, hidden).take(rows).collect();
        lines.reverse();
        // At the start of the history, newer lines fill the page.
        let missing = rows - lines.len();
        lines.extend(self.from(end, hidden).take(missing));
        lines.into_iter().map(|(_, line)| line).collect()
    }

    /// Number of lines newer than `until`, without hidden types.
    pub fn newer(&self, until: Option<u64>, hidden: &Hidden) -> usize {
        let end = self.end(until);
        self.shown(hidden).map(|lines| lines.len() - position(lines, end)).sum()
    }

    /// Scrolls a page of `rows` lines that ends at `until` back by `lines` lines that are not
    /// hidden. Returns the number of its new last line. It stops at the first page of the
    /// history.
    pub fn back(
        &self,
        until: Option<u64>,
        lines: usize,
        rows: usize,
        hidden: &Hidden,
    ) -> Option<u64> {
        let older: Vec<_> = self
            .before(self.end(until), hidden)
            .take(lines + rows)
            .map(|(number, _)| *number)
            .collect();
        match lines.min(older.len().saturating_sub(rows)) {
            0 => until,
            moved => older.get(moved).or(older.last()).copied(),
        }
    }

    /// Scrolls a page that ends at `until` by `lines` lines towards the newest. Returns the number
    /// of its new last line; `None` for the newest.
    pub fn forth(&self, until: Option<u64>, lines: usize, hidden: &Hidden) -> Option<u64> {
        let mut newer = self.from(self.end(until), hidden).skip(lines.saturating_sub(1));
        let (number, _) = newer.next()?;
        newer.next().map(|_| *number)
    }

    /// The number after the last line of a page that ends at `until`.
    fn end(&self, until: Option<u64>) -> u64 {
        until.map_or(self.next_number, |until| until + 1)
    }

    fn shown(&self, hidden: &Hidden) -> impl Iterator<Item = &Log<Numbered>> {
        self.types.iter().filter(|known| !hidden.contains(&known.name)).map(|known| &known.lines)
    }

    /// Lines with numbers below `end`, without hidden types, newest first.
    fn before(&self, end: u64, hidden: &Hidden) -> impl Iterator<Item = &Numbered> {
        let mut heads: Vec<_> =
            self.shown(hidden).map(|lines| (lines, position(lines, end))).collect();
        std::iter::from_fn(move || {
            let newest = |(lines, end): &&mut (&Log<Numbered>, usize)| {
                end.checked_sub(1).and_then(|last| lines.get(last)).map(|(number, _)| *number)
            };
            let (lines, end) = heads.iter_mut().max_by_key(newest)?;
            *end = end.checked_sub(1)?;
            lines.get(*end)
        })
    }

    /// Lines with numbers from `start` on, without hidden types, oldest first.
    fn from(&self, start: u64, hidden: &Hidden) -> impl Iterator<Item = &Numbered> {
        let mut heads: Vec<_> =
            self.shown(hidden).map(|lines| (lines, position(lines, start))).collect();
        std::iter::from_fn(move || {
            let oldest = |(lines, next): &&mut (&Log<Numbered>, usize)| {
                lines.get(*next).map_or(u64::MAX, |(number, _)| *number)
            };
            let (lines, next) = heads.iter_mut().min_by_key(oldest)?;
            let line = lines.get(*next)?;
            *next += 1;
            Some(line)
        })
    }
}

/// How many of `lines` have numbers below `number`.
fn position(lines: &Log<Numbered>, number: u64) -> usize {
    lines.partition_point(|(own, _)| *own < number)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(name: &str, number: u64) -> TrafficLine {
        TrafficLine::sample(number, name, &format!("{name} {number}"))
    }

    /// `count` seconds with 50 commands and one status each; the status is the last line of its
    /// second.
    fn seconds(count: u64) -> Traffic {
        let mut traffic = Traffic::default();
        for second in 0..count {
            (0..50).for_each(|command| traffic.push(line("command", second * 50 + command)));
            traffic.push(line("status", second));
        }
        traffic
    }

    fn texts(lines: Vec<&TrafficLine>) -> Vec<&str> {
        lines.into_iter().map(|line| line.text.as_str()).collect()
    }

    fn without(name: &str) -> Hidden {
        [name.to_owned()].into()
    }

    #[test]
    fn a_page_merges_the_types_in_the_order_of_their_lines() {
        let traffic = seconds(2);
        let all = Hidden::new();
        assert_eq!(texts(traffic.page(3, None, &all)), ["command 98", "command 99", "status 1"]);
        assert_eq!(
            texts(traffic.page(3, Some(51), &all)),
            ["command 49", "status 0", "command 50"]
        );
        assert_eq!(traffic.page(1000, None, &all).len(), 102);
        assert_eq!(traffic.last().unwrap().text, "status 1");
    }

    #[test]
    fn frequent_lines_do_not_push_rare_ones_out() {
        let traffic = seconds(1000);
        let statuses = traffic.page(2000, None, &without("command"));
        assert_eq!((statuses.len(), statuses[0].text.as_str()), (1000, "status 0"));
        let kept = traffic.page(usize::MAX, None, &without("status")).len();
        assert!(kept < 10_000, "{kept}");
        assert_eq!(traffic.types()[0].count, 50_000);
    }

    #[test]
    fn a_page_scrolls_by_visible_lines_and_stays_when_new_lines_come() {
        let mut traffic = seconds(20);
        let hidden = without("command");
        let until = traffic.back(None, 5, 4, &hidden);
        let page = ["status 11", "status 12", "status 13", "status 14"];
        assert_eq!(texts(traffic.page(4, until, &hidden)), page);
        assert_eq!(traffic.newer(until, &hidden), 5);
        traffic.push(line("status", 20));
        assert_eq!(texts(traffic.page(4, until, &hidden)), page);
        assert_eq!(traffic.newer(until, &hidden), 6);
        let until = traffic.forth(until, 5, &hidden);
        assert_eq!(texts(traffic.page(1, until, &hidden)), ["status 19"]);
        assert_eq!(traffic.forth(until, 5, &hidden), None);
        assert_eq!(traffic.forth(None, 5, &hidden), None);
    }

    #[test]
    fn scrolling_back_ends_with_the_first_full_page() {
        let traffic = seconds(2);
        let all = Hidden::new();
        let first = ["command 0", "command 1", "command 2"];
        let until = traffic.back(None, 1000, 3, &all);
        assert_eq!(texts(traffic.page(3, until, &all)), first);
        assert_eq!(traffic.back(until, 1000, 3, &all), until);
        assert_eq!(texts(traffic.page(3, Some(0), &all)), first, "newer lines fill the page");
        assert_eq!(traffic.back(None, 5, 1000, &all), None, "the page shows all lines");
    }

    #[test]
    fn the_number_of_types_is_bounded() {
        let mut traffic = Traffic::default();
        (0..1000).for_each(|number| traffic.push(line(&format!("message {number}"), number)));
        assert_eq!(traffic.types().len(), TYPES_MAX + 1);
        let last = traffic.types().last().unwrap();
        assert_eq!((last.name.as_str(), last.count), (FURTHER_TYPES, 1000 - TYPES_MAX as u64));
        assert_eq!(traffic.page(1000, None, &Hidden::new()).len(), 1000);
    }
}
