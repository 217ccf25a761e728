//! A bounded list of lines, newest last, for the panes that scroll.

use std::collections::VecDeque;

/// Lines kept of each type of traffic and of the serial monitor: 100 s of commands at 50 Hz, and
/// more than any screen shows.
const LINES_KEPT: usize = 5_000;

/// A bounded history.
#[derive(Clone, Debug)]
pub struct Log<T> {
    lines: VecDeque<T>,
}

impl<T> Default for Log<T> {
    fn default() -> Log<T> {
        Log { lines: VecDeque::new() }
    }
}

impl<T> Log<T> {
    /// Adds the newest line. Drops the oldest one if the history is full.
    pub fn push(&mut self, line: T) {
        if self.lines.len() == LINES_KEPT {
            self.lines.pop_front();
        }
        self.lines.push_back(line);
    }

    /// Number of lines.
    pub fn len(&self) -> usize {
        self.lines.len()
    }

    /// True if there are no lines.
    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }

    /// The last `count` lines before the newest `skip` lines, oldest first.
    pub fn tail(&self, count: usize, skip: usize) -> impl Iterator<Item = &T> {
        let end = self.lines.len().saturating_sub(skip);
        self.lines.range(end.saturating_sub(count)..end)
    }

    /// The line at `index`; the oldest line is at 0.
    pub fn get(&self, index: usize) -> Option<&T> {
        self.lines.get(index)
    }

    /// Number of lines that satisfy `predicate`. These must come before all that do not.
    pub fn partition_point(&self, predicate: impl FnMut(&T) -> bool) -> usize {
        self.lines.partition_point(predicate)
    }

    /// The newest line.
    pub fn last(&self) -> Option<&T> {
        self.lines.back()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn histories_are_bounded() {
        let mut log = Log::default();
        for number in 0..LINES_KEPT + 10 {
            log.push(number);
        }
        assert_eq!(log.len(), LINES_KEPT);
        assert_eq!(log.tail(2, 1).copied().collect::<Vec<_>>(), [LINES_KEPT + 7, LINES_KEPT + 8]);
    }
}
