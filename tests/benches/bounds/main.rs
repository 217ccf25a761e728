//! Prints what is proved of each program beside what the simulator observes, and the calculation of
//! the reception, and writes them to docs/benchmarks.md.
//!
//! Each program of both chips runs in floods of each kind of frame, of [`FLOOD_MS`] simulated time
//! each, and the loaders run as in [`rig::loader`].

mod reason;
mod reception;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use bench::wiring::Wiring;
use bounds::report::{Report, Scope};
use rig::flood::{Flood, Scenario, Setup, Traffic};
use rig::observed::{OF_KINDS, Observer, Pair, ROUNDS, WITH_CALL};
use rig::reception::{report, report_of_frames};
use rig::{loader, parallel};

use reason::Reason;
use reception::{Seen, queue_row, reception_rows};

/// Simulated time of each flood.
const FLOOD_MS: u64 = 200;

const HEADING: &str = "## Proved and observed";

/// Boards of whose loaders the page tells: one for each chip.
const LOADERS: [&str; 2] = ["diecimila", "uno"];

/// The kind of turns that read frames of which INT0 was masked (avr-specs/bounds.toml). Each other
/// kind can have it, too, and takes as much longer as *INT0 blocked* says; the page omits these.
const MISSED: &str = "missed frames";

/// A figure, and why its bound is loose.
struct Row {
    pair: Pair,
    reason: Reason,
}

fn main() {
    // Cargo also asks bench targets to list their tests.
    if std::env::args().any(|argument| argument == "--list") {
        return;
    }
    let mut programs: BTreeMap<String, Vec<Setup>> = BTreeMap::new();
    for setup in Setup::ALL {
        programs.entry(program(setup)).or_default().push(setup);
    }
    let mut figures = String::from(
        "| program | figure | proved | observed | ratio | why above 1.5 |\n\
         | --- | --- | ---: | ---: | ---: | --- |\n",
    );
    let mut turns = String::from(
        "| program | turn | proved | observed | ratio | why above 2 |\n\
         | --- | --- | ---: | ---: | ---: | --- |\n",
    );
    let (mut receptions, mut queues) = (reception::heading(), reception::queue_heading());
    for (name, setups) in &programs {
        let elf = fs::read(setups[0].elf()).expect("the program was built");
        let report = report(&elf, Scope::Everything, |_| {});
        let (rows, seen) = observed(setups, &elf, &report);
        for row in &rows {
            match row.pair.name.strip_prefix(OF_KINDS) {
                None => figures.push_str(&row.text(name, &row.pair.name)),
                Some(kinds) if kinds.contains(MISSED) => {}
                Some(kinds) => turns.push_str(&row.text(name, kinds)),
            }
        }
        receptions.push_str(&reception_rows(name, &elf, &seen));
        let turn = rows.iter().find(|row| row.pair.name == "turn of the main loop");
        let turn = turn.map_or(0, |row| row.pair.observed);
        queues.push_str(&queue_row(name, &report, &seen, turn));
    }
    for name in LOADERS {
        let wiring = Wiring::of(name, "seeed").unwrap_or_else(|error| panic!("{error:#}"));
        let report = loader::report(&wiring);
        for pair in loader::observed(&wiring, &report) {
            let row = Row { pair, reason: Reason::None };
            let name = row.pair.name.clone();
            figures.push_str(&row.text(&format!("loader, {}", wiring.chip.name()), &name));
        }
    }
    let reception = format!("{}\n{receptions}\n{}\n{queues}", reception::TEXT, reception::QUEUE);
    let measured = rig::page::measured();
    let part =
        format!("{HEADING}\n\n{TEXT}\n{figures}\n{TURNS}\n{turns}\n{reception}\n\n{measured}");
    print!("{part}");
    rig::page::write_part(HEADING, &part);
}

fn program(setup: Setup) -> String {
    format!("{:?}", setup.preset).to_lowercase()
}

impl Row {
    /// The row of the table.
    fn text(&self, program: &str, name: &str) -> String {
        let Pair { proved, observed, .. } = &self.pair;
        let ratio = match observed {
            0 => "-".into(),
            _ => format!("{:.2}", f64::from(*proved) / f64::from(*observed)),
        };
        let why = self.reason.text(&self.pair);
        format!("| {program} | {name} | {proved} | {observed} | {ratio} | {why} |\n")
    }
}

/// The longest of all floods, the stretches of each interrupt together, and what was seen of the
/// queues of each setup.
fn observed(setups: &[Setup], elf: &[u8], report: &Report) -> (Vec<Row>, Vec<Seen>) {
    let floods: Vec<Scenario> = setups
        .iter()
        .flat_map(|setup| Traffic::all(*setup).into_iter().map(|kind| Scenario::full(*setup, kind)))
        .map(|flood| Scenario { measures_service: true, ..flood })
        .collect();
    let times = report.times.as_ref().expect("times");
    let one = report_of_frames(elf, 1);
    let all = parallel::each(&floods, |scenario| {
        let mut flood = Flood::new(*scenario);
        let observer = Observer::begin(flood.rig.board().avr_mut(), times);
        flood.run_ms(FLOOD_MS);
        (observer.observed(), Seen::of(scenario, &flood.outcome))
    });
    let ran: BTreeSet<&str> =
        all.iter().flat_map(|(observed, _)| observed.handlers.keys().copied()).collect();
    let mut longest: Vec<Row> = Vec::new();
    let mut seen = Vec::new();
    for (observed, queue) in all {
        seen.push(queue);
        for (pair, of_one) in observed.beside(report).into_iter().zip(observed.beside(&one)) {
            let name = without_addresses(&pair.name);
            let known = longest
                .iter_mut()
                .find(|row| row.pair.name == name && row.pair.proved == pair.proved);
            match known {
                Some(known) => known.pair.observed = known.pair.observed.max(pair.observed),
                None => {
                    let reason = Reason::of(&pair, &of_one, report, &ran);
                    longest.push(Row { pair: Pair { name, ..pair }, reason });
                }
            }
        }
    }
    // Of a handler there is a row already.
    longest.retain(|row| !row.pair.name.contains("__vector") && row.pair.proved != u32::MAX);
    // `--loops` lists them.
    longest.retain(|row| !row.pair.name.starts_with(WITH_CALL));
    // tests/boards/bounds.rs compares them.
    longest.retain(|row| !row.pair.name.starts_with(ROUNDS));
    (longest, seen)
}

/// Addresses differ with each change of the program.
fn without_addresses(name: &str) -> String {
    let words = name.split(' ').filter(|word| !word.starts_with("0x") && *word != "to");
    words.collect::<Vec<&str>>().join(" ").replace("__avr_device_rt_main", "the main loop")
}

const TEXT: &str = "\
Written by `make bench`. *Proved* is the longest path of the machine code (crates/avr-bounds),
*observed* the most in floods of each kind of frame. Cycles of 62.5 ns; the stack in bytes, where a
ratio above 1.25 has a reason. INT0 is the interrupt of the controller. A stretch of the main loop
takes from the instruction that masks it to the one that unmasks it. The loader sends a response of
seven frames while others keep each of them from the bus, and checks the longest program.
";

/// What the table of the turns says.
const TURNS: &str = "\
### Turns of the main loop

The agenda (src/node/agenda.rs) chooses one thing in each turn. `avr-specs/bounds.toml` names the
kinds of turns by the functions that they call, and each combination that the machine code has a
path for has a bound of its own; *no kind* calls none of them. Each can also read the frames that
INT0 has missed, and then takes longer by the bound of that stretch, above. *entry* follows an entry
of a command or records a rejected transfer, *service* takes a request or begins a response,
*message* puts a message together, and *step* makes bytes of a frame.
";
