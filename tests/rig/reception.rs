//! The calculation that the controller's receive buffers never overflow, from what is proved of
//! the handler of its interrupt: response-time analysis of frames that come as fast as the bus
//! allows (Davis, Burns, Bril, Lukkien: Controller Area Network schedulability analysis, 2007).
//!
//! A frame waits for the rest of the handler, which has just looked at INT; for the longest masked
//! stretch of the main program, which begins then; for the handler, until it releases the buffer;
//! and for the frames before it. Other handlers interrupt all of these. INT is low only while a
//! frame waits: the controller has no other interrupt enabled.

use std::fs;

use bench::root;
use bounds::annotations::{Annotations, Loop};
use bounds::chip::Chip;
use bounds::report::{Report, Scope};
use bounds::times::{HandlerTime, Times};

use crate::parallel;

/// Cycles of a bit at 1 Mbit/s.
const BIT: u32 = 16;
/// Bits of an extended frame without data and stuff bits, with the three bits before the next.
const FRAME_BITS: u32 = 67;
/// Lengths of frames with two buffers, in bytes: the shortest frame, the shortest of a transfer, a
/// command, the longest.
pub const LENGTHS: [u32; 4] = [0, 2, 5, 8];
/// The length of frames with one buffer, in bytes.
pub const SHORT: u32 = 2;
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

/// Buffers of the controller that a frame can go to. With several outputs each frame has two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Buffers {
    /// Short messages of which few come at a time.
    One = 1,
    /// All others.
    Two = 2,
}

/// What the calculation needs, in cycles.
#[derive(Clone, Debug)]
pub struct Reception {
    /// The handler from its last look at INT to its end.
    pub rest: u32,
    /// The longest masked stretch of the main program.
    pub masked: u32,
    /// From the response to the release of the first frame.
    pub release: u32,
    /// The same of a frame of [`SHORT`] bytes.
    short_release: u32,
    /// Each further frame.
    pub frame: u32,
    /// The handler of the millisecond, and the one of the edges: cycles and the time between two.
    pub others: Vec<(u32, u32)>,
    /// Some types have one buffer: only one output is in use.
    pub has_one_buffer: bool,
    /// The handler of the edges, if the program can have several outputs, as one of the others.
    edges: Option<(u32, u32)>,
}

/// What is proved of a program with the project's annotations, which `change` may change.
///
/// # Panics
/// If the program cannot be followed.
pub fn report(elf: &[u8], scope: Scope, change: impl FnOnce(&mut Annotations)) -> Report {
    let text = fs::read_to_string(root().join("avr-specs/bounds.toml")).expect("the annotations");
    let mut annotations = Annotations::parse(&text).expect("annotations");
    change(&mut annotations);
    let chip = Chip::of_elf(elf).expect("an ELF").expect("the program names its chip");
    Report::of(elf, chip, annotations, scope).expect("the program can be followed")
}

/// What is proved of a program whose handler of INT0 reads at most so many frames after the first
/// one in a call.
pub fn report_of_frames(elf: &[u8], frames: u32) -> Report {
    report(elf, Scope::Everything, |annotations| read_at_most(annotations, frames))
}

fn read_at_most(annotations: &mut Annotations, frames: u32) {
    let fetch = annotations.loops.iter_mut().filter(|entry| entry.function == "fetch");
    fetch.for_each(|entry| entry.at_most = Some(frames));
}

impl Reception {
    /// Of a program, with one output in use.
    pub fn of(elf: &[u8]) -> Self {
        let of_each = [
            (Scope::Handlers, 0, SHORT),
            (Scope::Handlers, 1, 8),
            (Scope::Handlers, 2, 8),
            (Scope::Everything, 0, 8),
        ];
        let reports = parallel::each(&of_each, |(scope, frames, bytes)| {
            report(elf, *scope, |annotations| {
                read_at_most(annotations, *frames);
                annotations.loops.insert(0, reads(*bytes));
            })
        });
        let [short, one, two, none] = &reports[..] else { unreachable!("a report of each") };
        let release = |report: &Report| {
            // CS rises after READ RX BUFFER, and at last after the check behind it.
            let bits = handler(report, "INT0").bits.iter();
            let rises = bits.filter(|bit| bit.is_set && bit.register != EIMSK);
            rises.map(|bit| bit.cycles.0).min().expect("CS rises in the handler")
        };
        let further = |report: &Report| handler(report, "INT0").cycles.0;
        let looks = handler(none, "INT0").looks.iter().map(|look| look.cycles.0);
        let masked = times(none)
            .stretches
            .iter()
            .filter(|stretch| stretch.blocks == "INT0" && !stretch.begins.contains("__vector"));
        Self {
            rest: looks.max().expect("the handler looks at INT"),
            masked: masked.map(|stretch| stretch.cycles.0).max().unwrap_or(0),
            release: release(none),
            short_release: release(short),
            frame: further(two) - further(one),
            others: vec![(handler(none, "TIMER0_COMPA").cycles.0, TICK)],
            has_one_buffer: true,
            edges: find(none, "TIMER0_COMPB").map(|handler| (handler.cycles.0, EDGE)),
        }
    }

    /// The same with several outputs in use. `None` if the program has one.
    pub fn with_several_outputs(&self) -> Option<Self> {
        let others = [&self.others[..], &[self.edges?]].concat();
        Some(Self { others, has_one_buffer: false, ..self.clone() })
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

    /// The longest time from the end of a frame of so many bytes to the release of its buffer, if
    /// all frames are as long. `None` if the backlog grows.
    pub fn response(&self, bytes: u32, buffers: Buffers) -> Option<u32> {
        let release = if buffers == Buffers::One { self.short_release } else { self.release };
        self.longest(frame_cycles(bytes), release)
    }

    /// Cycles from then to the end of the frame that would be lost. `None` if the backlog grows.
    pub fn margin(&self, bytes: u32, buffers: Buffers) -> Option<i64> {
        Some(limit(bytes, buffers) - i64::from(self.response(bytes, buffers)?))
    }

    /// The least margin of all frames of transfers. `None` if a backlog grows.
    pub fn least_margin(&self) -> Option<i64> {
        let of_two = LENGTHS.map(|bytes| self.margin(bytes, Buffers::Two));
        let of_one = self.has_one_buffer.then(|| self.margin(SHORT, Buffers::One));
        of_two.into_iter().chain(of_one).min()?
    }
}

/// Cycles of a frame of so many bytes without stuff bits, with the bits before the next.
pub fn frame_cycles(bytes: u32) -> u32 {
    (FRAME_BITS + 8 * bytes) * BIT
}

/// Cycles from the end of a frame to the end of the one that would be lost.
pub fn limit(bytes: u32, buffers: Buffers) -> i64 {
    i64::from(buffers as u32 * frame_cycles(bytes))
}

fn handler<'a>(report: &'a Report, name: &str) -> &'a HandlerTime {
    find(report, name).unwrap_or_else(|| panic!("a handler of {name}"))
}

fn find<'a>(report: &'a Report, name: &str) -> Option<&'a HandlerTime> {
    times(report).handlers.iter().find(|handler| handler.interrupt == name)
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
