//! The calculation that the controller's receive buffers never overflow, from what is proved of
//! the handler of its interrupt: response-time analysis of frames that come as fast as the bus
//! allows (Davis, Burns, Bril, Lukkien: Controller Area Network schedulability analysis, 2007).
//!
//! A frame waits for the rest of the handler, which has just looked at INT; for the longest masked
//! stretch of the main program, which begins then; for the handler, until it releases the buffer;
//! and for the frames before it. Other handlers interrupt all of these. INT is low only while a
//! frame waits: the controller has no other interrupt enabled.

use std::fmt::Write as _;

use bounds::annotations::Loop;
use bounds::report::Report;
use bounds::times::{HandlerTime, Times};

use super::report;

/// Cycles of a bit at 1 Mbit/s.
const BIT: u32 = 16;
/// Bits of an extended frame without data and stuff bits, with the three bits before the next.
const FRAME_BITS: u32 = 67;
/// Lengths of the table, in bytes: the shortest frame, that of types with one buffer, a command,
/// the longest.
const LENGTHS: [u32; 4] = [0, 2, 5, 8];
/// The length of frames with one buffer, in bytes.
const SHORT: u32 = 2;
/// Instructions of the main program between two interrupts, and the longest before the response.
const INSTRUCTIONS: u32 = 5 + 4;
/// Between two ticks of the millisecond.
const TICK: u32 = 16_000;
/// Between two edges of the outputs: 100 us (src/board/outputs.rs).
const EDGE: u32 = 1_600;
/// Frames that are followed. A backlog that lasts longer never ends.
const MOST_FRAMES: u32 = 10_000;
/// EIMSK in the data space.
const EIMSK: u16 = 0x3D;

/// What the calculation needs, in cycles.
pub struct Reception {
    /// The handler from its last look at INT to its end.
    rest: u32,
    /// The longest masked stretch of the main program.
    masked: u32,
    /// From the response to the release of the first frame.
    release: u32,
    /// The same of a frame of [`SHORT`] bytes.
    short_release: u32,
    /// Each further frame.
    frame: u32,
    /// The handler of the millisecond, and the one of the edges: cycles and the time between two.
    others: Vec<(u32, u32)>,
}

impl Reception {
    /// Of a program. `has_edges`: several outputs are in use.
    pub fn of(elf: &[u8], has_edges: bool) -> Self {
        let with = |frames: u32, bytes: u32| {
            report(elf, |annotations| {
                let fetch = annotations.loops.iter_mut().filter(|entry| entry.function == "fetch");
                fetch.for_each(|entry| entry.at_most = Some(frames));
                annotations.loops.insert(0, reads(bytes));
            })
        };
        let (none, one, two) = (with(0, 8), with(1, 8), with(2, 8));
        let release = |report: &Report| {
            // CS rises after READ RX BUFFER, and at last after the check behind it.
            let bits = handler(report, "INT0").bits.iter();
            let rises = bits.filter(|bit| bit.is_set && bit.register != EIMSK);
            rises.map(|bit| bit.cycles.0).min().expect("CS rises in the handler")
        };
        let further = |report: &Report| handler(report, "INT0").cycles.0;
        let looks = handler(&none, "INT0").looks.iter().map(|look| look.cycles.0);
        let mut others = vec![(handler(&none, "TIMER0_COMPA").cycles.0, TICK)];
        if has_edges {
            others.push((handler(&none, "TIMER0_COMPB").cycles.0, EDGE));
        }
        let masked = times(&none)
            .stretches
            .iter()
            .filter(|stretch| stretch.blocks == "INT0" && !stretch.begins.contains("__vector"));
        Self {
            rest: looks.max().expect("the handler looks at INT"),
            masked: masked.map(|stretch| stretch.cycles.0).max().unwrap_or(0),
            release: release(&none),
            short_release: release(&with(0, SHORT)),
            frame: further(&two) - further(&one),
            others,
        }
    }

    /// Time of the handlers that interrupt, in a window.
    fn interrupted(&self, window: u32) -> u32 {
        self.others.iter().map(|(cycles, every)| window.div_ceil(*every) * cycles).sum()
    }

    /// The longest time from the end of a frame to the release of its buffer, if frames come each
    /// `every` cycles. `None` if the backlog grows.
    fn longest(&self, every: u32, release: u32) -> Option<u32> {
        // Or the handler has just looked for other frames.
        let before = (self.rest + self.masked + INSTRUCTIONS).max(self.frame);
        let mut longest = 0;
        for frames in 0..MOST_FRAMES {
            let own = before + release + frames * self.frame;
            let mut window = own;
            while own + self.interrupted(window) > window {
                window = own + self.interrupted(window);
            }
            let Some(response) = window.checked_sub(frames * every).filter(|left| *left > 0) else {
                return Some(longest);
            };
            longest = longest.max(response);
            // Without a backlog the next frame finds what the first one found.
            if window + self.frame - release.min(self.frame) <= (frames + 1) * every {
                return Some(longest);
            }
        }
        None
    }

    /// The heading of the table.
    pub fn heading() -> String {
        let mut heading = String::from(
            "| program | rest | masked | release | further frame | longest time to release | ",
        );
        for length in LENGTHS {
            let _ = write!(heading, "two buffers, {length} B | ");
        }
        heading.push_str("one buffer, 2 B |\n| --- |");
        heading.push_str(&" ---: |".repeat(5 + LENGTHS.len() + 1));
        heading.push('\n');
        heading
    }

    /// A row: the margins of two buffers for each length, and of one buffer.
    pub fn row(&self, name: &str) -> String {
        let every = |length: u32| (FRAME_BITS + 8 * length) * BIT;
        let margin = |length: u32, buffers: u32, release: u32| {
            let limit = i64::from(buffers * every(length));
            match self.longest(every(length), release) {
                Some(longest) if i64::from(longest) <= limit => {
                    (limit - i64::from(longest)).to_string()
                }
                Some(longest) => format!("only tested ({})", limit - i64::from(longest)),
                None => "only tested".into(),
            }
        };
        let shown = self
            .longest(every(SHORT), self.release)
            .map_or("-".into(), |longest| longest.to_string());
        let mut row = format!(
            "| {name} | {} | {} | {} | {} | {shown} |",
            self.rest, self.masked, self.release, self.frame
        );
        for length in LENGTHS {
            let _ = write!(row, " {} |", margin(length, 2, self.release));
        }
        let _ = writeln!(row, " {} |", margin(SHORT, 1, self.short_release));
        row
    }
}

fn handler<'a>(report: &'a Report, name: &str) -> &'a HandlerTime {
    let found = times(report).handlers.iter().find(|handler| handler.interrupt == name);
    found.unwrap_or_else(|| panic!("a handler of {name}"))
}

/// The loop that reads the identifier, and then so many bytes of data.
fn reads(bytes: u32) -> Loop {
    const IDENTIFIER: u32 = 4;
    Loop {
        function: "CanSpi::read".into(),
        number: Some(1),
        with: None,
        chip: None,
        begins: None,
        at_most: Some(bytes.max(IDENTIFIER) - 1),
        until: None,
        is_turn: false,
        reason: "the frame has no more bytes".into(),
    }
}

fn times(report: &Report) -> &Times {
    report.times.as_ref().expect("times")
}
