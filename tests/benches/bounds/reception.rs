//! The tables of the reception: the controller's buffers ([`rig::reception`]) and the queue.

use std::fmt::Write as _;

use bounds::report::Report;
use rig::flood::{Outcome, Scenario};
use rig::reception::{Buffers, LENGTHS, Reception, SHORT, frame_cycles, limit};

/// What a flood has shown.
pub struct Seen {
    has_several_outputs: bool,
    /// The longest time from the end of a frame to its release, in cycles.
    release: u32,
    /// Most frames in the queue, and its places.
    deepest: u8,
    places: u8,
    lost: u64,
}

impl Seen {
    /// Of a flood.
    pub fn of(scenario: &Scenario, outcome: &Outcome) -> Self {
        Self {
            has_several_outputs: scenario.setup.outputs() > 1,
            release: outcome.meter.latency.max(),
            deepest: outcome.deepest,
            places: outcome.places,
            lost: outcome.meter.lost,
        }
    }
}

/// The heading of the table of the buffers.
pub fn heading() -> String {
    let mut heading =
        String::from("| program | rest | masked | release | further frame | proved | observed | ");
    for length in LENGTHS {
        let _ = write!(heading, "two buffers, {length} B | ");
    }
    let _ = write!(heading, "one buffer, {SHORT} B |\n| --- |");
    heading.push_str(&" ---: |".repeat(6 + LENGTHS.len() + 1));
    heading.push('\n');
    heading
}

/// The rows of a program: with one output, and with several if it has them.
pub fn reception_rows(name: &str, elf: &[u8], seen: &[Seen]) -> String {
    let has_several = seen.iter().any(|seen| seen.has_several_outputs);
    let of =
        |is_several: bool| seen.iter().filter(move |seen| seen.has_several_outputs == is_several);
    let reception = Reception::of(elf);
    let one = row(&reception, name, has_several.then_some("one output"), of(false));
    match reception.with_several_outputs().filter(|_| has_several) {
        None => one,
        Some(several) => one + &row(&several, name, Some("several outputs"), of(true)),
    }
}

/// A row: the margins of two buffers for each length, and of one buffer.
fn row<'a>(
    reception: &Reception,
    name: &str,
    outputs: Option<&str>,
    seen: impl Iterator<Item = &'a Seen>,
) -> String {
    let observed = seen.map(|seen| seen.release).max().expect("a flood");
    let name = outputs.map_or(name.into(), |outputs| format!("{name}, {outputs}"));
    let Reception { rest, masked, release, frame, .. } = reception;
    let proved = reception.response(SHORT, Buffers::Two);
    let proved = proved.map_or("none".into(), |cycles| cycles.to_string());
    let mut row =
        format!("| {name} | {rest} | {masked} | {release} | {frame} | {proved} | {observed} |");
    let two = LENGTHS.map(|bytes| (bytes, Buffers::Two));
    let one = reception.has_one_buffer.then_some((SHORT, Buffers::One));
    for (bytes, buffers) in two.into_iter().chain(one) {
        let margin = reception.margin(bytes, buffers);
        let tested = limit(bytes, buffers) - i64::from(observed);
        let _ = match margin {
            Some(cycles) if cycles >= 0 => write!(row, " {cycles} |"),
            Some(cycles) => write!(row, " only tested: {tested} (proof {cycles}) |"),
            None => write!(row, " only tested: {tested} ({}) |", backlog(reception, bytes)),
        };
    }
    if one.is_none() {
        row += " none |";
    }
    row + "\n"
}

/// Why a backlog of frames of this length can grow: the time of a frame in the handler, with the
/// handlers that interrupt it.
fn backlog(reception: &Reception, bytes: u32) -> String {
    let share: f64 =
        reception.others.iter().map(|(cycles, every)| f64::from(*cycles) / f64::from(*every)).sum();
    let frame = f64::from(reception.frame) / (1.0 - share);
    format!("a frame takes up to {frame:.0} of {}", frame_cycles(bytes))
}

/// The heading of the table of the queue.
pub fn queue_heading() -> String {
    "| program | places | most used | frames lost | all places, 2 B | a turn, proved | a turn, \
     observed | |\n| --- | ---: | ---: | ---: | ---: | ---: | ---: | --- |\n"
        .into()
}

/// The row of a program, whose longest turn took `observed` cycles.
pub fn queue_row(name: &str, report: &Report, seen: &[Seen], observed: u32) -> String {
    let most = |what: fn(&Seen) -> u8| seen.iter().map(what).max().expect("a flood");
    let places = most(|seen| seen.places);
    let fill = u32::from(places) * frame_cycles(SHORT);
    let lost: u64 = seen.iter().map(|seen| seen.lost).sum();
    let turn = report.times.as_ref().and_then(|times| times.turn.as_ref()).expect("a turn");
    // A turn acts on one frame.
    let is_proved = turn.cycles.0 <= frame_cycles(SHORT);
    let verdict =
        if is_proved { "proved" } else { "only tested: a turn can be longer than a frame" };
    let deepest = most(|seen| seen.deepest);
    format!(
        "| {name} | {places} | {deepest} | {lost} | {fill} | {} | {observed} | {verdict} |\n",
        turn.cycles.0
    )
}

/// What the table of the buffers says.
pub const TEXT: &str = "\
### Reception

Frames arrive as fast as the bus allows, without stuff bits: 1,072 cycles for a frame without data,
1,328 for the shortest of a transfer, 2 bytes, and 128 for each further byte. A frame waits at most
for the *rest* of the handler, which has just looked at INT, for the longest *masked* stretch of the
main loop, and for its own *release*; each *further frame* adds its part while there is a backlog.
The handler of the millisecond interrupts all of these, and with several outputs that of the edges
each 100 us. *Proved* is the longest time from the end of a frame to the release of its buffer
(frames each 1,328 cycles), *observed* the longest in the floods. The other columns have the margin
until a frame would be lost: at the second frame behind it with two buffers, at the next one with
one. A node with one output has one buffer for SafetyState, ArmingStatus and ServoCommand, which
have 2 bytes, and for other messages of one frame, and two buffers for commands, 5 bytes or more,
and requests, 1 or more. With several outputs each frame has two buffers. No frame of a transfer is
shorter than a byte. `make test` fails if a proved margin of a node with one output is less than 10
cycles, or with several for frames of 5 bytes or more.

*Only tested*: the calculation does not prove it, and the number is the margin that the floods have
left. In brackets is what the calculation has: the missing cycles, or why a backlog can grow.
";

/// What the table of the queue says.
pub const QUEUE: &str = "\
A turn of the main loop acts on one frame of the queue, or does one other thing. If no turn could be
longer than a frame, it would be proved that the queue never overflows. The bound of a turn is
longer, because it adds up parts that exclude each other, and so are turns that were seen: a command
for a position alone takes longer than its frame (above, *Load*). So the queue rests on the mean of
the turns, which `make losses`, `make test` and the floods of this page test.
";
