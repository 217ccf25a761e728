//! Tables of tests. A line that is not indented names a test; the indented lines below it are
//! statements for a new [`Lab`] or [`Rig`], with `;` between those of a line. `each $a $b: 1 2, 3
//! 4~5` repeats the test with these words; `~` is a space. Frames are in candump's form.
//!
//! Statements for both: `nodes N`; `send N FRAME`; `got N FRAME...` expects what node N has
//! received (in a [`Rig`] since the last `got`); `counters N TEC REC`; `state N STATE`.
//!
//! Of a [`Lab`]. A bit is counted from the SOF of the first frame: a number, or `crc`, `ack` or
//! `eof` for its CRC delimiter, its ACK slot and its last bit, with a number behind: `eof-1`.
//!
//! | statement | |
//! | --- | --- |
//! | `cold N` | nodes that have not received a bit yet |
//! | `mode N MODE`, `loopback N`, `rec N REC` | sets a mode; raises the receive error counter |
//! | `see BIT N LEVEL`, `flip BIT N` | N, or `all`, receive a level, or the frame's bit inverted |
//! | `hold BIT BIT LEVEL` | all receive the level from a bit to before another |
//! | `from now` | counts bits from here, without a frame |
//! | `run N`, `to BIT`, `settle` | some bits pass, the bits before one, or all frames |
//! | `sent FRAME...` | expects the order of all frames that have been sent |
//! | `errors N KIND...` | expects these errors of node N |
//! | `until N STATE` | bits pass until node N has this error state |
//! | `at BIT N EVENT`, `has` | expects the event, or a kind of error, at this bit only, or also |
//! | `dominant N BIT BIT`, `recessive N BIT BIT` | expects what N drove up to before a bit |
//! | `is N WORD...` | expects of node N `idle`, `busy`, `sending`, `quiet` |
//!
//! Of a [`Rig`].
//!
//! | statement | |
//! | --- | --- |
//! | `inject FAULT on`, `flip BIT for N`, `lose N`, `clear` | begins faults, and ends all |
//! | `connect N on` | connects node N; `off` disconnects it |
//! | `bits N` | some bits pass |
//! | `happened N EVENT` | expects that node N had this event |
//! | `queued N COUNT`, `frames COUNT`, `error frames COUNT` | expects these numbers |
//! | `wire LEVEL` | expects the level of the bus |

use super::*;

/// Runs the tests of a table.
#[track_caller]
pub fn run_all<T: Bench>(table: &str) {
    let mut tests: Vec<(&str, Vec<&str>)> = vec![];
    for line in table.lines().filter(|line| !line.is_empty()) {
        match (line.starts_with(' '), tests.last_mut()) {
            (true, Some((_, script))) => script.extend(line.split(';').map(str::trim)),
            _ => tests.push((line, vec![])),
        }
    }
    assert!(!tests.is_empty());
    for (name, script) in tests {
        match script[0].strip_prefix("each ").and_then(|each| each.split_once(": ")) {
            None => run_one::<T>(name, &script.join(";")),
            Some((places, rows)) => {
                for row in rows.split(", ") {
                    let mut script = script[1..].join(";");
                    for (place, words) in places.split(' ').zip(row.split(' ')) {
                        script = script.replace(place, &words.replace('~', " "));
                    }
                    run_one::<T>(&format!("{name} ({row})"), &script);
                }
            }
        }
    }
}

#[track_caller]
fn run_one<T: Bench>(name: &str, script: &str) {
    let mut bench = T::of(0);
    for statement in script.split(';') {
        let words: Vec<&str> = statement.split_whitespace().collect();
        let what = format!("{name}: \"{statement}\"");
        match words[..] {
            ["nodes", count] => bench = T::of(number(count)),
            ["send", node, text] => bench.send(number(node), frame(text)),
            ["got", node, ref expected @ ..] => {
                let expected: Vec<Frame> = expected.iter().map(|text| frame(text)).collect();
                assert_eq!(bench.received(number(node)), expected, "{what}");
            }
            ["counters", node, tec, rec] => {
                let expected = (number(tec) as u16, number(rec) as u16);
                assert_eq!(bench.counters(number(node)), expected, "{what}");
            }
            ["state", node, state] => {
                assert_eq!(format!("{:?}", bench.state(number(node))), state, "{what}");
            }
            _ => bench.run(&words, &what),
        }
    }
}

/// What has nodes.
pub trait Bench {
    fn of(count: usize) -> Self;
    fn send(&mut self, node: usize, frame: Frame);
    fn received(&mut self, node: usize) -> Vec<Frame>;
    fn counters(&self, node: usize) -> (u16, u16);
    fn state(&self, node: usize) -> ErrorState;
    /// Does a statement of this kind of bench.
    fn run(&mut self, words: &[&str], what: &str);
}

fn number(text: &str) -> usize {
    text.parse().unwrap_or_else(|_| panic!("{text} is no number"))
}

/// A lab, and the first frame with the bit in which it began.
pub struct FromSof {
    lab: Lab,
    first: Option<Frame>,
    start: u64,
}

impl FromSof {
    /// The number of a bit since the lab's start.
    fn bit(&self, text: &str) -> u64 {
        let bits = self.first.as_ref().map(bits_of);
        let terms = text.split_inclusive(['+', '-']);
        let of = |term: &str| match (term, &bits) {
            ("crc", Some(bits)) => bits.crc_delimiter,
            ("ack", Some(bits)) => bits.ack_slot,
            ("eof", Some(bits)) => bits.last_eof,
            _ => number(term) as u64,
        };
        let mut bit = self.start;
        let mut is_less = false;
        for term in terms {
            let value = of(term.trim_end_matches(['+', '-']));
            bit = if is_less { bit - value } else { bit + value };
            is_less = term.ends_with('-');
        }
        bit
    }

    fn disturb(&mut self, bit: u64, node: &str, level: Level) {
        let node = (node != "all").then(|| number(node));
        self.lab.disturbed.push((bit, node, level));
    }
}

fn is_event(event: Event, name: &str) -> bool {
    match event {
        Event::Error { kind, .. } => name == "Error" || format!("{kind:?}") == name,
        Event::Received(_) => name == "Received",
        Event::Transmitted(_) => name == "Transmitted",
        _ => format!("{event:?}") == name,
    }
}

impl Bench for FromSof {
    fn of(count: usize) -> Self {
        FromSof { lab: Lab::of(count), first: None, start: 0 }
    }

    fn send(&mut self, node: usize, frame: Frame) {
        if self.first.is_none() {
            (self.first, self.start) = (Some(frame), self.lab.bit);
        }
        self.lab.send(node, frame);
    }

    fn received(&mut self, node: usize) -> Vec<Frame> {
        self.lab.received(node)
    }

    fn counters(&self, node: usize) -> (u16, u16) {
        self.lab.counters(node)
    }

    fn state(&self, node: usize) -> ErrorState {
        self.lab.engines[node].error_state()
    }

    fn run(&mut self, words: &[&str], what: &str) {
        match *words {
            ["cold", count] => self.lab = Lab::cold(number(count)),
            ["mode", node, mode] => {
                let modes = [EngineMode::Off, EngineMode::Normal, EngineMode::ListenOnly];
                let mode = modes.into_iter().find(|one| format!("{one:?}") == mode).expect(what);
                self.lab.engines[number(node)].set_mode(mode);
            }
            ["loopback", node] => self.lab.engines[number(node)].set_self_ack(true),
            ["rec", node, rec] => self.lab.raise_rec(number(node), number(rec) as u16),
            ["see", bit, node, level] => {
                self.disturb(self.bit(bit), node, Level::from_bit(level == "1"));
            }
            ["flip", bit, node] => {
                let bit = self.bit(bit);
                let bits = self.first.expect("a frame").wire_bits();
                self.disturb(bit, node, !bits[(bit - self.start) as usize]);
            }
            ["hold", from, to, level] => {
                let level = Level::from_bit(level == "1");
                (self.bit(from)..self.bit(to)).for_each(|bit| self.disturb(bit, "all", level));
            }
            ["to", bit] => self.lab.run(self.bit(bit) - self.lab.bit),
            ["sent", ref expected @ ..] => {
                let sent = self.lab.events.iter().filter_map(|&(_, _, event)| match event {
                    Event::Transmitted(frame) => Some(frame.to_string()),
                    _ => None,
                });
                assert_eq!(sent.collect::<Vec<_>>(), expected, "{what}");
            }
            ["from", "now"] => self.start = self.lab.bit,
            ["run", bits] => self.lab.run(number(bits) as u64),
            ["settle"] => self.lab.settle(),
            ["errors", node, ref expected @ ..] => {
                let errors = self.lab.errors_of(number(node));
                let errors: Vec<String> = errors.iter().map(|kind| format!("{kind:?}")).collect();
                assert_eq!(errors, expected, "{what}");
            }
            ["at", bit, node, event] => {
                let bits = self.lab.bits_where(number(node), |found| is_event(found, event));
                assert_eq!(bits, [self.bit(bit)], "{what}");
            }
            ["has", bit, node, event] => {
                let bits = self.lab.bits_where(number(node), |found| is_event(found, event));
                assert!(bits.contains(&self.bit(bit)), "{what}: {bits:?}");
            }
            ["until", node, state] => {
                let end = self.lab.bit + 10_000;
                while format!("{:?}", self.state(number(node))) != state {
                    assert!(self.lab.bit < end, "{what}: not in time");
                    self.lab.step();
                }
            }
            [level @ ("dominant" | "recessive"), node, from, to] => {
                let bits = self.bit(from)..self.bit(to);
                let level = Level::from_bit(level == "recessive");
                assert!(self.lab.drove(number(node), level, bits), "{what}");
            }
            ["is", node, ref expected @ ..] => {
                let engine = &self.lab.engines[number(node)];
                let idle = if engine.is_idle() { "idle" } else { "busy" };
                let sending = if engine.transmitting() { "sending" } else { "quiet" };
                assert!(expected.iter().all(|word| [idle, sending].contains(word)), "{what}");
            }
            _ => panic!("{what}: no such statement"),
        }
    }
}

impl Bench for Rig {
    fn of(count: usize) -> Self {
        Rig::of(count)
    }

    fn send(&mut self, node: usize, frame: Frame) {
        Rig::send(self, node, frame);
    }

    fn received(&mut self, node: usize) -> Vec<Frame> {
        Rig::received(self, node)
    }

    fn counters(&self, node: usize) -> (u16, u16) {
        Rig::counters(self, node)
    }

    fn state(&self, node: usize) -> ErrorState {
        self.nodes[node].borrow().error_state()
    }

    fn run(&mut self, words: &[&str], what: &str) {
        let bit = |text| number(text) as u32;
        match *words {
            ["inject", fault, on] => {
                let faults: [fn(bool) -> Fault; 5] = [
                    Fault::NoAck,
                    Fault::AckDestroyed,
                    Fault::DestroyFrames,
                    Fault::StuckDominant,
                    Fault::StuckRecessive,
                ];
                let is = |make: &fn(bool) -> Fault| format!("{:?}", make(true)).starts_with(fault);
                let make = faults.into_iter().find(is).expect(what);
                self.bus.inject(make(on == "on"));
            }
            ["flip", at, "for", node] => {
                let port = self.ports[number(node)];
                self.bus.inject(Fault::FlipBitSeenBy { port, bit: bit(at) });
            }
            ["lose", node] => {
                self.bus.inject(Fault::LoseNextFrame { port: self.ports[number(node)] });
            }
            ["clear"] => self.bus.clear_faults(),
            ["connect", node, on] => self.bus.connect(self.ports[number(node)], on == "on"),
            ["bits", count] => self.run_bits(number(count) as u64),
            ["happened", node, name] => {
                let events = self.events(number(node));
                assert!(events.iter().any(|event| is_event(*event, name)), "{what}: {events:?}");
            }
            ["wire", level] => {
                assert_eq!(self.bus.level(), Level::from_bit(level == "1"), "{what}");
            }
            ["queued", node, count] => {
                assert_eq!(self.nodes[number(node)].borrow().queued(), number(count), "{what}");
            }
            ["error", "frames", count] => {
                assert_eq!(self.bus.stats().error_frames, number(count) as u64, "{what}");
            }
            ["frames", count] => {
                assert_eq!(self.bus.stats().frames, number(count) as u64, "{what}");
            }
            _ => panic!("{what}: no such statement"),
        }
    }
}
