//! The load of a running bus over the last second, by sender and data type.
//!
//! Counts every bit from SOF to the end of the intermission, like a plan. A record is counted at
//! its end, so a frame at the limit of the second counts completely or not at all.

use bench::can::{Id, Record, RecordKind};
use bench::dronecan::dialect::{DialectFinder, announced};
use sim_base::{Cycles, F_CPU_HZ};
use std::collections::{HashMap, VecDeque};

/// The measured time.
const WINDOW: Cycles = F_CPU_HZ;
/// Bits of the intermission, which belong to the frame before.
const INTERMISSION_BITS: u32 = 3;

/// The sender that a load is attributed to. The order is that of lines with equal loads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
enum Source {
    Node(u8),
    /// A node without an ID.
    Anonymous,
    /// Frames that do not belong to the dialect.
    Foreign,
    /// Error frames, which have no sender.
    Bus,
}

/// A line of the table: a sender, and an index into the names of types.
type Key = (Source, usize);

#[derive(Clone, Copy, Debug)]
struct Passed {
    end: Cycles,
    bits: u32,
    key: Key,
}

#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    frames: u64,
    bits: u64,
}

/// Bits on the bus in the last second, by sender and data type.
#[derive(Clone, Debug, Default)]
pub struct LoadByType {
    bit_rate: u32,
    /// Oldest first. The number is limited by what a bus can carry in a second.
    window: VecDeque<Passed>,
    sums: HashMap<Key, Sum>,
    names: Vec<String>,
    dialects: DialectFinder,
}

impl LoadByType {
    /// For a bus of `bit_rate` bits per second.
    pub fn new(bit_rate: u32) -> LoadByType {
        LoadByType { bit_rate, ..LoadByType::default() }
    }

    /// Counts a frame or error frame. Records must be in order of time.
    pub fn record(&mut self, record: &Record) {
        let (source, name) = attribute(record, &mut self.dialects);
        let key = (source, self.name_index(name));
        let bits = record.bits + INTERMISSION_BITS;
        let sum = self.sums.entry(key).or_default();
        sum.frames += 1;
        sum.bits += u64::from(bits);
        self.window.push_back(Passed { end: record.end, bits, key });
        self.forget(record.end);
    }

    /// A table of `width` columns and at most `height` lines, heaviest first, for the second before
    /// `now`.
    ///
    /// The last line sums up the lines that do not fit.
    pub fn lines(&mut self, now: Cycles, width: usize, height: usize) -> Vec<String> {
        self.forget(now);
        let mut sums: Vec<(Key, Sum)> = self.sums.iter().map(|(key, sum)| (*key, *sum)).collect();
        sums.sort_by_key(|&((source, name), sum)| {
            (std::cmp::Reverse(sum.bits), source, &self.names[name])
        });
        let span_s = now.clamp(1, WINDOW) as f64 / F_CPU_HZ as f64;
        let line = |who: &str, what: &str, sum: Sum| self.line(who, what, sum, span_s);
        let total = sums.iter().fold(Sum::default(), |total, (_, sum)| total.plus(*sum));
        let mut lines = vec![format!(
            "{:>4} {:26} {:>8} {:>9} {:>7}",
            "node", "type", "frames/s", "bits/s", "load %"
        )];
        lines.push(line("all", "", total));
        let room = height.saturating_sub(lines.len());
        // The sum needs its own line.
        let shown = if sums.len() > room { room.saturating_sub(1) } else { sums.len() };
        lines.extend(
            sums[..shown]
                .iter()
                .map(|&((source, name), sum)| line(&source.text(), &self.names[name], sum)),
        );
        if shown < sums.len() {
            let rest = sums[shown..].iter().fold(Sum::default(), |rest, (_, sum)| rest.plus(*sum));
            lines.push(line("", &format!("{} more", sums.len() - shown), rest));
        }
        lines.truncate(height);
        lines.iter_mut().for_each(|line| *line = line.chars().take(width).collect());
        lines
    }

    fn line(&self, who: &str, what: &str, sum: Sum, span_s: f64) -> String {
        let per_second = |count: u64| count as f64 / span_s;
        let percent = per_second(sum.bits) * 100.0 / f64::from(self.bit_rate.max(1));
        let (frames, bits) = (per_second(sum.frames), per_second(sum.bits));
        // A long name is truncated to keep the columns.
        format!("{who:>4} {what:26.26} {frames:8.0} {bits:9.0} {percent:7.2}")
    }

    fn forget(&mut self, now: Cycles) {
        let Some(oldest) = now.checked_sub(WINDOW) else { return };
        while let Some(&Passed { bits, key, .. }) =
            self.window.front().filter(|passed| passed.end <= oldest)
        {
            self.window.pop_front();
            let sum = self.sums.get_mut(&key).expect("what is in the window is in the sums");
            sum.frames -= 1;
            sum.bits -= u64::from(bits);
            if sum.frames == 0 {
                self.sums.remove(&key);
            }
        }
    }

    /// A bus has few types, so a linear search is fast. A babbling node with random types only
    /// fills one line.
    fn name_index(&mut self, name: String) -> usize {
        const NAMES_MAX: usize = 512;
        const OTHER: &str = "(other)";
        let known = |names: &[String], name: &str| names.iter().position(|known| known == name);
        if let Some(index) = known(&self.names, &name) {
            return index;
        }
        let name = if self.names.len() < NAMES_MAX { name } else { String::from(OTHER) };
        known(&self.names, &name).unwrap_or_else(|| {
            self.names.push(name);
            self.names.len() - 1
        })
    }
}

impl Sum {
    fn plus(self, other: Sum) -> Sum {
        Sum { frames: self.frames + other.frames, bits: self.bits + other.bits }
    }
}

impl Source {
    fn text(self) -> String {
        match self {
            Source::Node(id) => id.to_string(),
            Source::Anonymous => String::from("anon"),
            Source::Foreign | Source::Bus => String::from("-"),
        }
    }
}

fn attribute(record: &Record, dialects: &mut DialectFinder) -> (Source, String) {
    let frame = match record.kind {
        RecordKind::Frame { frame, .. } => frame,
        RecordKind::ErrorFrame { .. } => return (Source::Bus, String::from("error frames")),
    };
    let known = match frame.id {
        Id::Extended(id) if !frame.remote => announced(dialects.dialect(id, frame.data()), id),
        _ => None,
    };
    let Some((source, name)) = known else {
        return (Source::Foreign, String::from("not DroneCAN"));
    };
    (source.map_or(Source::Anonymous, |node| Source::Node(node.get())), name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench::can::{Bus, Frame, OnWire as _, SoftNode};
    use std::cell::RefCell;
    use std::rc::Rc;

    const STATUS_OF_10: u32 = 0x1001_550A;
    const COMMAND_OF_1: u32 = 0x0803_F201;

    fn extended(id: u32, data: &[u8]) -> Frame {
        Frame::extended(id, data)
    }

    /// The load of frames, each with its end.
    fn load(frames: impl IntoIterator<Item = (Cycles, Frame)>) -> LoadByType {
        let mut load = LoadByType::new(1_000_000);
        for (end, frame) in frames {
            let kind = RecordKind::Frame { frame, from: None, acked: true };
            load.record(&Record { start: end - 1, end, bits: frame.bit_count() - 3, kind });
        }
        load
    }

    fn words(line: &str) -> Vec<&str> {
        line.split_whitespace().collect()
    }

    #[test]
    fn loads_are_told_apart_by_node_and_type_the_heaviest_first() {
        let (status, command) = (extended(STATUS_OF_10, &[0; 8]), extended(COMMAND_OF_1, &[0; 5]));
        let commands = (1..=50).map(|ms| (ms * 20 * F_CPU_HZ / 1000, command));
        let mut load = load(commands.chain([(F_CPU_HZ, status)]));
        let lines = load.lines(F_CPU_HZ, 80, 10);
        let (all, each) = (50 * command.bit_count() + status.bit_count(), command.bit_count());
        let percent = format!("{:.2}", f64::from(all) / 1e4);
        assert_eq!(words(&lines[1]), ["all", "51", &all.to_string(), &percent]);
        assert_eq!(words(&lines[2])[..4], ["1", "ArrayCommand", "50", &(50 * each).to_string()]);
        assert_eq!(words(&lines[3])[..3], ["10", "NodeStatus", "1"]);
        assert_eq!(lines.len(), 4);
    }

    /// In the first half second of a run one frame counts as two a second.
    #[test]
    fn what_is_older_than_a_second_is_forgotten_and_a_shorter_run_is_scaled() {
        let status = extended(STATUS_OF_10, &[0; 8]);
        assert_eq!(words(&load([(1000, status)]).lines(F_CPU_HZ / 2, 80, 10)[2])[2], "2");
        let mut load = load([(F_CPU_HZ, status)]);
        assert_eq!(load.lines(2 * F_CPU_HZ - 1, 80, 10).len(), 3);
        assert_eq!(load.lines(2 * F_CPU_HZ, 80, 10).len(), 2);
        assert_eq!((load.window.len(), load.sums.len()), (0, 0));
    }

    #[test]
    fn services_anonymous_foreign_error_and_draft_frames_have_lines_of_their_own() {
        let frames = [
            (extended(0x1E01_AAF8, &[0xC0]), " 120 GetNodeInfo request"),
            (extended(0x1E01_2AAA, &[0xC0]), "  42 GetNodeInfo response"),
            (extended(0x1855_5100, &[0xC0]), "anon Allocation"),
            (Frame::standard(0x123, &[1]), "   - not DroneCAN"),
            (extended(0x17C4_0409, &[90]), "   1 draft.ThesisCommand"),
            (extended(0x1003_F20A, &[1, 0, 0, 0x38, 0xC7]), "  10 ArrayCommand"),
            (extended(0x1139_E005, &[0x7F; 8]), " 120 draft.GetNodeInfo response"),
        ];
        let mut load = load((1..).map(|number| number * 100).zip(frames.map(|(frame, _)| frame)));
        let kind = RecordKind::ErrorFrame { kind: None, from: None };
        load.record(&Record { start: 0, end: 900, bits: 30, kind });
        let text = load.lines(F_CPU_HZ, 80, 20).join("\n");
        for expected in frames.iter().map(|(_, line)| *line).chain(["   - error frames"]) {
            assert!(text.contains(expected), "{expected} is missing:\n{text}");
        }
    }

    #[test]
    fn the_table_keeps_to_its_size_and_sums_up_the_rest() {
        let frame = |node: u32| (1000 + u64::from(node), extended(0x1001_5500 | node, &[0; 8]));
        let mut load = load((1..=100).map(frame));
        let lines = load.lines(F_CPU_HZ, 80, 10);
        assert_eq!(lines.len(), 10);
        assert_eq!(words(&lines[9])[..3], ["93", "more", "93"]);
        for (width, height) in [(0, 0), (10, 1), (30, 2), (1, 3), (200, 4), (80, 200)] {
            let lines = load.lines(F_CPU_HZ, width, height);
            let fit = lines.len() <= height && lines.iter().all(|line| line.len() <= width);
            assert!(fit, "{width} x {height}");
        }
    }

    #[test]
    fn names_stay_bounded_when_types_are_invented() {
        let frame = |type_id: u32| (1000, extended(0x1000_0001 | (30_000 + type_id) << 8, &[0]));
        let mut load = load((0..2000).map(frame));
        assert_eq!(load.names.len(), 513);
        assert!(load.lines(F_CPU_HZ, 80, 5)[2].contains("(other)"));
    }

    /// The sum equals the bus's own count.
    #[test]
    fn the_total_is_the_load_of_the_bus() {
        let mut bus = Bus::new(1_000_000);
        let nodes = [(); 3].map(|()| Rc::new(RefCell::new(SoftNode::new(1_000_000))));
        for node in &nodes {
            bus.attach("node", node.clone());
        }
        for (at, node) in nodes.iter().enumerate() {
            for count in 0..200 {
                node.borrow_mut().send(extended(STATUS_OF_10 + at as u32, &[count; 8]));
            }
        }
        bus.run_until(F_CPU_HZ);
        let mut load = load([]);
        bus.take_records().iter().for_each(|record| load.record(record));
        let lines = load.lines(F_CPU_HZ, 80, 10);
        assert_eq!(words(&lines[1])[1..3], ["600", &bus.stats().busy_bits.to_string()]);
    }
}
